# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst reproduce mhl`: the MHL paper's experiments on a simulated mirror of two axes, everything through the real nodes in lockstep.

    traditional composite   H_S^-1 and PI (paper Eq. 9 and Fig. 7)
    proposed composite      H_S^-1, Ψ' behind N(s), and PI (Eq. 6, Fig. 6): N(s) as published, moved to 1 kHz, left out, and without
                            phase, which looks ahead
    whole inverse           the inverse of delay, H_D and G(s) with preview, and PI: past the paper

Nothing is taken from the plant's parameters. The composites take the inverse that was identified as the paper's was: its own curves, and Ψ'
from u - H_S^-1[y] on the raw sweep at the loop's rate. Their model has a record at 20 kHz: a delay of a third of the loop's sample and a
mode near half its rate cannot be told from samples of the loop.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from evaluation.reproduction import mhl_learning, mhl_tables
from evaluation.reproduction.figures import write_page
from evaluation.reproduction.machine_runs import signals_of
from evaluation.reproduction.margins import robustness
from evaluation.reproduction.mhl_runs import CENTRE, MIRROR, RATING, REACH, SAMPLE_TIME, SEED, Part, track
from evaluation.reproduction.papers import MHL
from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import CrossCoupling
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.feedforward.whole_inverse import lifted_inverse
from hyst_control.control.tuning import AUTOMATIC, tune
from hyst_control.identify import identify
from hyst_control.identify.mhl.paper_mhl import inverse_model
from hyst_control.model_file import Model, save_model
from hyst_control.records.excitation import excitation
from hyst_control.reporting.tables import Table

FINE_TIME = 5e-5
"""s, of the records up to 4 kHz, which the paper took with an oscilloscope."""
VERIFIED = (500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0)
FADE = 0.1
"""s, whole periods of every tone, over which a reference that does not begin at rest is faded in."""
RATE_FILTER = (3.23e-7, 9.1e-4, 1.0)
"""Denominator of the published N(s), descending powers of s (MHL paper §4.4)."""
STEP = 0.2
"""mrad, of the step whose settling time is measured."""
OTHER_STEPS = (-0.2, 0.5, -0.5)
"""mrad; the paper does not say how high its step was."""
PUBLISHED_CORNER = 1.0 / (2.0 * np.pi * np.sqrt(RATE_FILTER[0]))
"""Hz, of N(s) as published: 280."""
MOVED_CORNER = 1000.0
"""Hz, of N(s) placed anew, its damping kept: beyond the 100 Hz over which Ψ' was identified, and below the mode."""
NO_FILTER = (0.0,)
MOVED_FILTER = tuple(
    value * (PUBLISHED_CORNER / MOVED_CORNER) ** power for power, value in zip((2, 1, 0), RATE_FILTER, strict=True)
)
SMOOTHING = 4
"""Order of the whole inverse's low-pass without phase: -3 dB at 1.65 kHz, 10 % above the bandwidth that is asked for; and of the N
without phase, -3 dB at 460 Hz."""


@dataclass(frozen=True)
class Composite:
    """One of the paper's compensators.

    kind: of the compensator; inverse: its inverse model (`slower`: Ψ' with the k2' of the paper's Table 2; `ahead`: behind the N without
    phase); rate_filter: denominator of N(s), a single 0 for none; smoothing: order of the N without phase, 0 for none.
    """

    kind: str
    inverse: str = "inverse"
    rate_filter: tuple[float, ...] = NO_FILTER
    smoothing: int = 0


COMPOSITES = {
    mhl_tables.TRADITIONAL: Composite("mhl_static"),
    mhl_tables.PUBLISHED: Composite("mhl", rate_filter=RATE_FILTER),
    mhl_tables.MOVED: Composite("mhl", rate_filter=MOVED_FILTER),
    mhl_tables.WITHOUT: Composite("mhl"),
    mhl_tables.AHEAD: Composite("mhl", "ahead", smoothing=SMOOTHING),
    mhl_tables.SLOWER: Composite("mhl", "slower"),
}
AS_PUBLISHED = (mhl_tables.TRADITIONAL, mhl_tables.PUBLISHED)
"""The composites that run with the paper's PI too, which has no roll-off."""


def run(figures: str | None = None) -> Table:
    """Record, identify, tune, track and score, and return the table."""
    table, learning = Table("reproduce mhl"), Table("reproduce mhl")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        training = MIRROR.record(folder / "training", identification(SAMPLE_TIME, 2.0), SEED)
        checks = {"static": static_check(), "multi": multi_frequency_check()}
        checked = {name: (MIRROR.record(folder / name, rows, SEED + 1), scored) for name, (rows, scored) in checks.items()}
        fine = MIRROR.record(folder / "fine", identification(FINE_TIME, 1.0), SEED + 2, FINE_TIME)
        fast, places = fast_check()
        verified = MIRROR.record(folder / "verified", fast, SEED + 3, FINE_TIME)
        fits = {"paper": identify([fine], "mhl", "paper"), "joint": identify([training], "mhl", "joint")}
        inverses = {
            "inverse": inverse_model([training]),
            "slower": inverse_model([training], k2=MHL.published["table_2"]["k2'"]),
            "ahead": inverse_model([training], smoothing=SMOOTHING),
        }

        joint = without_coupling(fits["joint"].model)
        tuning, plain = (tune(joint, sample_time=SAMPLE_TIME, roll_off=roll_off) for roll_off in (AUTOMATIC, 0.0))
        reference, parts = tracking_reference()
        for name, model in {"joint": joint, **inverses}.items():
            save_model(model, folder / f"{name}.yaml")
        runs = [(name, name, tuning) for name in COMPOSITES] + [(name + mhl_tables.PLAIN, name, plain) for name in AS_PUBLISHED]
        tracked = {}
        for name, composite, feedback in runs:
            given = COMPOSITES[composite]
            settings = {
                "inverse_model": str(folder / f"{given.inverse}.yaml"),
                "rate_filter": list(given.rate_filter),
                "discretisation": "tustin",
                "smoothing": given.smoothing,
            }
            preview = given.smoothing + 1 if given.smoothing else 0
            tracked[name] = track(folder / file_name(name), given.kind, reference, feedback, settings, preview)
        inverse = build_compensator(joint, "mhl_inverse", sample_time=SAMPLE_TIME, limits=RATING, smoothing=SMOOTHING)
        whole = {"smoothing": SMOOTHING}
        for name, whole_feedback in (("whole inverse", tuning), ("whole inverse, no feedback", None)):
            tracked[name] = track(folder / file_name(name), "mhl_inverse", reference, whole_feedback, whole, inverse.preview)
        # The limit of any feedforward: the whole model is inverted over the whole reference by iteration.
        command = lifted_inverse(joint, reference, sample_time=SAMPLE_TIME, limits=RATING).command
        bag = MIRROR.open_loop(folder / "lifted", command, SEED + 4, start="rest")
        tracked["lifted inverse, no feedback"] = {**signals_of(bag), "reference": reference}
        mhl_learning.add(learning, folder, tuning, inverse.preview, SMOOTHING)

    mhl_tables.parameters(table, fits["paper"], inverses["inverse"])
    mhl_tables.widening(table, training)
    mhl_tables.predictions(table, {name: fit.model for name, fit in fits.items()}, checked["static"], checked["multi"])
    mhl_tables.fast(table, fits["paper"].model, verified, places)
    mhl_tables.open_loop(table, fits["paper"].model, fine)
    mhl_tables.tracking(table, tracked, parts)
    mhl_tables.feedback_effort(table, tracked, parts)
    mhl_tables.phases(table, *checked["multi"], inverses["inverse"], RATE_FILTER)
    mhl_tables.closed_loop(table, tracked, parts, SAMPLE_TIME)
    table.rows += learning.rows
    robustness(table, tuning)
    table.notes += [*MHL.notes, *MHL.not_scored]
    if figures is not None:
        write_page(figures, table)
    return table


def identification(sample_time: float, sweep_time: float) -> Annotated[Array, "N 2"]:
    """Build the excitation of paper §4.2, one axis after the other."""
    return excitation.build(
        {"signal": "mhl_identification", "peak": RATING[1], "sweep_time": sweep_time, "lower": RATING[0], "upper": RATING[1]},
        sample_time,
        len(MIRROR.axes),
    )


def static_check() -> tuple[Array, list[slice]]:
    """1 Hz loops of other amplitudes than the identification's (Fig. 9), after one that fills the memory; the rows of each axis."""
    waves = [excitation.loops(SAMPLE_TIME, 1.0, share * RATING[1], 1) for share in (1.0, 0.9, 0.7, 0.5, 0.3)]
    return one_after_the_other(np.concatenate(waves), SAMPLE_TIME)


def multi_frequency_check() -> tuple[Array, list[slice]]:
    """v = 50 - 19.2 sin 30πt - 10.7 (sin 80πt + sin 150πt + sin 200πt) (paper §4.3), after a loop that fills the memory."""
    wave = excitation.multi_frequency(SAMPLE_TIME, (15.0, 40.0, 75.0, 100.0), (-19.2, -10.7, -10.7, -10.7), 50.0, 0.4)
    return one_after_the_other(np.concatenate([conditioned(SAMPLE_TIME, 50.0), wave]), SAMPLE_TIME)


def fast_check() -> tuple[Array, list[tuple[float, slice, slice]]]:
    """Sines of 10 V about 50 V at the frequencies of Table 3; of each the frequency, and the rows without its beginning by axis."""
    pieces, places = [conditioned(FINE_TIME, 50.0)], []
    for frequency in VERIFIED:
        begin = sum(len(piece) for piece in pieces)
        pieces += [excitation.sine(FINE_TIME, frequency, 10.0, 50.0, 0.05), excitation.rest(FINE_TIME, 0.02, 50.0)]
        places.append((frequency, begin + int(0.02 / FINE_TIME), begin + int(0.05 / FINE_TIME)))
    rows, (_, later) = one_after_the_other(np.concatenate(pieces), FINE_TIME)
    shift = later.stop - sum(len(piece) for piece in pieces)
    return rows, [(frequency, slice(begin, end), slice(begin + shift, end + shift)) for frequency, begin, end in places]


def one_after_the_other(wave: Annotated[Array, "N"], sample_time: float) -> tuple[Array, list[slice]]:
    """Put a wave on each axis in turn, with the other axis at rest at 0 V.

    The paper's model has no cross-coupling, so each axis is scored alone.
    """
    back = [excitation.cosine_ramp(sample_time, float(wave[-1]), 0.0, 0.1), excitation.rest(sample_time, 0.05)]
    own = np.concatenate([wave, *back])
    rows = np.zeros((2 * len(own), 2))
    rows[: len(own), 0] = rows[len(own) :, 1] = own
    first = int(np.flatnonzero(wave >= 0.99 * wave.max())[0])
    return rows, [slice(first, len(wave)), slice(len(own) + first, len(own) + len(wave))]


def conditioned(sample_time: float, end: float) -> Annotated[Array, "N"]:
    """Build a ramp to the rating, down to 0 and to a final voltage, which fills the hysteresis' memory."""
    return np.concatenate(
        [excitation.cosine_ramp(sample_time, *step, 0.2) for step in ((0.0, RATING[1]), (RATING[1], 0.0), (0.0, end))]
        + [excitation.rest(sample_time, 0.02, end)]
    )


def tracking_reference() -> tuple[Array, dict[str, Part]]:
    """The reference (N, 2) in mrad of one run: the paper's four references, steps, and a small multisine for the response."""
    ts = SAMPLE_TIME
    pieces: list[Array] = []
    parts: dict[str, Part] = {}

    def add(name: str, x: Array, y: Array | None = None, skipped: float = 0.0, after: Array | None = None) -> None:
        """One experiment, joined to what was before along half a cosine; `after` is how x comes to rest, and is not scored."""
        rows = np.stack([x, np.full(len(x), CENTRE) if y is None else y], axis=1)
        last = pieces[-1][-1] if pieces else np.zeros(2)
        pieces.append(np.stack([excitation.cosine_ramp(ts, a, b, 0.1) for a, b in zip(last, rows[0], strict=True)], axis=1))
        pieces.append(np.repeat(rows[:1], int(0.02 / ts), axis=0))
        begin = sum(map(len, pieces))
        pieces.append(rows)
        parts[name] = Part(begin, begin + len(rows), begin + int(round(skipped / ts)))
        if after is not None:
            pieces.append(np.stack([after, np.full(len(after), rows[-1, 1])], axis=1))

    slow = excitation.sine(ts, 5.0, 0.95 * REACH, CENTRE, 0.2, -np.pi / 2)
    add("conditioning", slow, slow)
    lowest = np.array([CENTRE - REACH])
    add("single", excitation.sine(ts, 100.0, REACH, CENTRE, 0.2, -np.pi / 2), skipped=0.02, after=lowest)
    # These begin and end in the middle of their motion: they are faded in and out, so that there is no kink in velocity.
    before = faded(excitation.sine(ts, 100.0, REACH, CENTRE, FADE))
    wave = np.concatenate([before, excitation.decaying_sine(ts, 100.0, REACH, CENTRE, 0.2, 0.1 * REACH)])
    add("decreasing", wave, skipped=FADE, after=faded(excitation.sine(ts, 100.0, 0.1 * REACH, CENTRE, FADE), out=True))
    scale = REACH / 50.0
    tones = (20.0, 60.0, 100.0), (-35.3 * scale, -19.6 * scale, -19.6 * scale), CENTRE
    whole = excitation.multi_frequency(ts, *tones, FADE)
    wave = np.concatenate([faded(whole), excitation.multi_frequency(ts, *tones, 0.2)])
    add("multi", wave, skipped=FADE, after=faded(whole, out=True))
    spiral = excitation.spiral(ts, 2, REACH, 20.0, 0.5, CENTRE)
    add("spiral", spiral[:, 0], spiral[:, 1])
    add("step", excitation.step(ts, STEP, CENTRE, 0.02, 0.08))
    add("response", excitation.multisine(ts, 0.2, 5.0, 2495.0, 0.02, 1, CENTRE, 6, seed=SEED)[:, 0], skipped=0.4)
    for height in OTHER_STEPS:
        add(f"step of {height:g} mrad", excitation.step(ts, height, CENTRE, 0.02, 0.08))
    pieces.append(np.repeat(pieces[-1][-1:], int(0.02 / ts), axis=0))
    return np.concatenate(pieces), parts


def faded(wave: Annotated[Array, "N"], out: bool = False) -> Annotated[Array, "N"]:
    """Fade a wave in along half a cosine from rest at the center, or out to it."""
    half = 0.5 * np.cos(np.pi * np.arange(len(wave)) / len(wave))
    return CENTRE + (wave - CENTRE) * (0.5 + half if out else 0.5 - half)


def without_coupling(model: Model) -> Model:
    """Remove the cross-coupling from a model: the compensators treat each axis alone."""
    return model.with_stages([stage for stage in model.chain.stages if not isinstance(stage, CrossCoupling)])


def file_name(name: str) -> str:
    """The `name` of a compensator as that of a folder."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)
