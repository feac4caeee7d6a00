"""`hyst reproduce mhl`: the MHL paper's experiments on a truth mirror of two axes, everything through the real nodes in lockstep.

Excite at the loop's rate, record, identify in the paper's sequence and jointly, tune the PI feedback, track. The published
figures are of the paper's mirror; the plant here is a simulated one whose hysteresis, relaxation and resonance are not the
model's own, and nothing is taken from its parameters.

    traditional composite   H_S^-1 and PI (paper Eq. 9 and Fig. 7)
    proposed composite      H_S^-1, Ψ behind N(s), and PI (Eq. 6, Fig. 6)
    whole inverse           the inverse of delay, H_D and G(s) with preview, and PI: past the paper

The composites invert the model of the paper's sequence, as published. The whole inverse takes the model of all records together,
which predicts better, and looks at the reference through a low-pass without phase: no command makes the mirror jump in one tick.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyst_control.chain.linear import CrossCoupling
from hyst_control.chain.stage import Array
from hyst_control.config_files import config_path
from hyst_control.control.feedforward import build_compensator
from hyst_control.control.tuning import Tuning, tune
from hyst_control.control.whole_inverse import lifted_inverse
from hyst_control.identify import identify
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.workflow import datasets_of
from hyst_control.model_file import Model, save_model
from hyst_control.records import excitation
from hyst_control.records.bag_reader import read_bag
from hyst_control.reporting.tables import Table
from hyst_control.reproduction import mhl_figures, mhl_tables
from hyst_control.reproduction.node_runs import run_processes

SAMPLE_TIME = 2e-4
"""s, of the loop and its records (paper §4.5)."""
FINE_TIME = 5e-5
"""s, of the records up to 4 kHz, which the paper took with an oscilloscope."""
AXES = ("x", "y")
RATING = (0.0, 100.0)
SLEW_LIMIT = 1e6
CENTRE, REACH = 1.0, 0.9
"""mrad; of 0 … 2 mrad the last twentieth at either end is left, where remanence keeps the mirror from its end."""
SEED = 626
BLOCK = 500
VERIFIED = (500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0)
STEP = 0.2
"""mrad, of the step whose settling time is measured."""
OTHER_STEPS = (-0.2, 0.5, -0.5)
"""mrad; the paper does not say how high its step was."""
KINDS = {"traditional composite": "mhl_static", "proposed composite": "mhl"}
SMOOTHING = 4
"""Order of the whole inverse's low-pass without phase: -3 dB at 1.65 kHz, 10 % above the bandwidth that is asked for."""


@dataclass(frozen=True)
class Part:
    """Rows of the tracking run that belong to one experiment, and those of them that are scored."""

    begin: int
    end: int
    scored: int


def run(json_path: str | None = None, figures: str | None = None) -> Table:
    """Record, identify, tune, track, score; the table. Raises `InputError` when a node fails."""
    table = Table("reproduce mhl")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        training = record(folder / "training", identification(SAMPLE_TIME, 2.0), SAMPLE_TIME, SEED)
        static, multi = (
            record(folder / name, rows, SAMPLE_TIME, SEED + 1)
            for name, rows in (("static", static_check()), ("multi", multi_frequency_check()))
        )
        fits = {method: identify([training], "mhl", method) for method in ("paper", "joint")}
        fine = record(folder / "fine", identification(FINE_TIME, 1.0), FINE_TIME, SEED + 2)
        fast, places = fast_check()
        verified = record(folder / "verified", fast, FINE_TIME, SEED + 3)
        fine_fit = identify([fine], "mhl", "paper")

        tuning = tune(without_coupling(fits["joint"].model), sample_time=SAMPLE_TIME)
        reference, parts = tracking_reference()
        models = {method: without_coupling(fit.model) for method, fit in fits.items()}
        for method, model in models.items():
            save_model(model, folder / f"{method}.yaml")
        tracked = {
            name: track(folder / kind, kind, folder / "paper.yaml", models["paper"], reference, tuning)
            for name, kind in KINDS.items()
        }
        for name, feedback in (("whole inverse", tuning), ("whole inverse, no feedback", None)):
            tracked[name] = track(
                folder / name.replace(", ", "_"),
                "mhl_inverse",
                folder / "joint.yaml",
                models["joint"],
                reference,
                feedback,
                SMOOTHING,
            )
        tracked["lifted inverse, no feedback"] = lifted(folder / "lifted", models["joint"], reference)

    mhl_tables.parameters(table, fits["paper"])
    mhl_tables.predictions(table, {name: fit.model for name, fit in fits.items()}, static, multi)
    mhl_tables.fast(table, fine_fit.model, verified, places)
    mhl_tables.tracking(table, tracked, parts)
    mhl_tables.error_spectrum(table, tracked, parts["single"], SAMPLE_TIME)
    mhl_tables.closed_loop(table, tracked, parts, SAMPLE_TIME)
    mhl_tables.robustness(table, tuning)
    table.notes += mhl_tables.NOTES
    if json_path:
        table.write(json_path)
    if figures:
        mhl_figures.write(
            Path(figures),
            table,
            fits,
            fine_fit,
            {"static": static, "multi": multi, "fast": verified, "fine": fine},
            places,
            tracked,
            parts,
        )
    return table


def identification(sample_time: float, sweep_time: float) -> Array:
    """The excitation (N, 2) in V of paper §4.2, one axis after the other."""
    return excitation.build(
        {"signal": "mhl_identification", "peak": RATING[1], "sweep_time": sweep_time, "lower": RATING[0], "upper": RATING[1]},
        sample_time,
        len(AXES),
    )


def static_check() -> Array:
    """1 Hz loops of other amplitudes than the identification's (Fig. 9), of both axes, after one that fills the memory."""
    waves = [excitation.loops(SAMPLE_TIME, 1.0, share * RATING[1], 1) for share in (1.0, 0.9, 0.7, 0.5, 0.3)]
    return np.repeat(np.concatenate(waves)[:, None], 2, axis=1)


def multi_frequency_check() -> Array:
    """v = 50 - 19.2 sin 30πt - 10.7 (sin 80πt + sin 150πt + sin 200πt) (paper §4.3), after a loop that fills the memory."""
    wave = excitation.multi_frequency(SAMPLE_TIME, (15.0, 40.0, 75.0, 100.0), (-19.2, -10.7, -10.7, -10.7), 50.0, 0.4)
    return np.repeat(np.concatenate([conditioned(SAMPLE_TIME, 50.0), wave])[:, None], 2, axis=1)


def fast_check() -> tuple[Array, list[tuple[float, int, int]]]:
    """Sines of 10 V about 50 V at the frequencies of Table 3, and the rows of each without its beginning."""
    pieces, places = [conditioned(FINE_TIME, 50.0)], []
    for frequency in VERIFIED:
        begin = sum(len(piece) for piece in pieces)
        pieces += [excitation.sine(FINE_TIME, frequency, 10.0, 50.0, 0.05), excitation.rest(FINE_TIME, 0.02, 50.0)]
        places.append((frequency, begin + int(0.02 / FINE_TIME), begin + int(0.05 / FINE_TIME)))
    return np.repeat(np.concatenate(pieces)[:, None], 2, axis=1), places


def conditioned(sample_time: float, end: float) -> Array:
    """Up to the rating, down to 0 and to `end` V."""
    return np.concatenate(
        [excitation.cosine_ramp(sample_time, *step, 0.2) for step in ((0.0, RATING[1]), (RATING[1], 0.0), (0.0, end))]
        + [excitation.rest(sample_time, 0.02, end)]
    )


def tracking_reference() -> tuple[Array, dict[str, Part]]:
    """The reference (N, 2) in mrad of one run: the paper's four references, steps, and a small multisine for the response."""
    ts = SAMPLE_TIME
    pieces: list[Array] = []
    parts: dict[str, Part] = {}

    def add(name: str, x: Array, y: Array | None = None, skipped: float = 0.0) -> None:
        """One experiment, joined to what was before along half a cosine."""
        rows = np.stack([x, np.full(len(x), CENTRE) if y is None else y], axis=1)
        last = pieces[-1][-1] if pieces else np.zeros(2)
        pieces.append(np.stack([excitation.cosine_ramp(ts, a, b, 0.1) for a, b in zip(last, rows[0], strict=True)], axis=1))
        pieces.append(np.repeat(rows[:1], int(0.02 / ts), axis=0))
        begin = sum(len(piece) for piece in pieces)
        pieces.append(rows)
        parts[name] = Part(begin, begin + len(rows), begin + int(round(skipped / ts)))

    add(
        "conditioning",
        excitation.sine(ts, 5.0, 0.95 * REACH, CENTRE, 0.2, -np.pi / 2),
        excitation.sine(ts, 5.0, 0.95 * REACH, CENTRE, 0.2, -np.pi / 2),
    )
    add("single", excitation.sine(ts, 100.0, REACH, CENTRE, 0.2, -np.pi / 2), skipped=0.02)
    add("decreasing", excitation.decaying_sine(ts, 100.0, REACH, CENTRE, 0.2, 0.1 * REACH))
    scale = REACH / 50.0
    add("multi", excitation.multi_frequency(ts, (20.0, 60.0, 100.0), (-35.3 * scale, -19.6 * scale, -19.6 * scale), CENTRE, 0.2))
    spiral = excitation.spiral(ts, 2, REACH, 20.0, 0.5, CENTRE)
    add("spiral", spiral[:, 0], spiral[:, 1])
    add("step", excitation.step(ts, STEP, CENTRE, 0.02, 0.08))
    add("response", excitation.multisine(ts, 0.2, 5.0, 2495.0, 0.02, 1, CENTRE, 6, seed=SEED)[:, 0], skipped=0.4)
    for height in OTHER_STEPS:
        add(f"step of {height:g} mrad", excitation.step(ts, height, CENTRE, 0.02, 0.08))
    pieces.append(np.repeat(pieces[-1][-1:], int(0.02 / ts), axis=0))
    return np.concatenate(pieces), parts


def without_coupling(model: Model) -> Model:
    """The model's axes by themselves: the compensators treat each alone."""
    return model.with_stages([stage for stage in model.chain.stages if not isinstance(stage, CrossCoupling)])


def record(folder: Path, signal: Array, sample_time: float, seed: int) -> Dataset:
    """An open-loop record of the truth mirror for a drive (N, 2) in V."""
    bag = run_processes(
        folder,
        signal,
        sample_time,
        {
            "mhl_feedforward": {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
            "pi_feedback": {"lower": RATING[0], "upper": RATING[1], "start": "first_command"},
            "plant": {"plant": str(config_path("plants/fsm.yaml")), "seed": seed},
        },
        AXES,
        "mrad",
        BLOCK,
        feedforward="mhl_feedforward",
    )
    return datasets_of(read_bag(bag))[0]


def track(
    folder: Path, kind: str, path: Path, model: Model, reference: Array, tuning: Tuning | None, smoothing: int = 0
) -> dict[str, Array]:
    """One tracking run with a compensator, and feedback where it is tuned; every signal (N, 2)."""
    preview = build_compensator(model, kind, sample_time=SAMPLE_TIME, limits=RATING, smoothing=smoothing).preview
    feedback = {"lower": RATING[0], "upper": RATING[1], "slew_limit": SLEW_LIMIT, "feedback": tuning is not None}
    if tuning is not None:
        feedback |= {"kp": tuning.kp, "ki": tuning.ki}
    bag = run_processes(
        folder,
        reference,
        SAMPLE_TIME,
        {
            "mhl_feedforward": {"kind": kind, "model": str(path), "limits": list(RATING), "smoothing": smoothing},
            "pi_feedback": feedback,
            "plant": {"plant": str(config_path("plants/fsm.yaml")), "seed": SEED + 4},
        },
        AXES,
        "mrad",
        1 if tuning else BLOCK,
        preview + 1,
        "mhl_feedforward",
    )
    return signals_of(bag)


def lifted(folder: Path, model: Model, reference: Array) -> dict[str, Array]:
    """The ceiling of a feedforward: the whole model inverted over the whole reference by iteration, driven open loop."""
    command = lifted_inverse(model, reference, sample_time=SAMPLE_TIME, limits=RATING).command
    bag = run_processes(
        folder,
        command,
        SAMPLE_TIME,
        {
            "mhl_feedforward": {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
            "pi_feedback": {"lower": RATING[0], "upper": RATING[1]},
            "plant": {"plant": str(config_path("plants/fsm.yaml")), "seed": SEED + 4},
        },
        AXES,
        "mrad",
        BLOCK,
        feedforward="mhl_feedforward",
    )
    return {**signals_of(bag), "reference": reference}


def signals_of(bag: Path) -> dict[str, Array]:
    """The signals of a tracking run on one clock."""
    return dict(read_bag(bag).aligned(("reference", "feedforward", "feedback", "command", "measurement"))[0].values)


def conditioned_rows(data: Dataset) -> int:
    """The rows before the drive has been at the top of the major loop."""
    return int(np.flatnonzero(data.command[:, 0] >= 0.99 * data.command[:, 0].max())[0])
