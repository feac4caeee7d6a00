# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst reproduce hampi`: the HAMPI paper's experiments on a simulated actuator, everything through the real nodes in lockstep.

Excite, record, identify in the paper's sequence and jointly, score on held-out loops, track open loop. The plant's hysteresis and drag are
not the model's own, and nothing is taken from its parameters. Its drag grows with the polarization, and more while it rises: what HAMPI's
dynamic weights are made for. The second truth, Bouc-Wen hysteresis and a viscoelastic ladder, has nothing of the kind. Models that track
are identified up to 50 V; those for 100 and 140 V up to 145 V, at frequencies none of which is a held-out one.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from evaluation.reproduction import hampi_tables
from evaluation.reproduction.figures import write_page
from evaluation.reproduction.hampi_tables import SCORED_CYCLES, Place
from evaluation.reproduction.machine_runs import Machine
from evaluation.reproduction.margins import robustness
from evaluation.reproduction.papers import HAMPI
from hyst_control.base.arrays import Array
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.tuning import tune
from hyst_control.identify import identify
from hyst_control.model_file import Model, save_model
from hyst_control.records.excitation import excitation
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table

GIVEN = HAMPI.published
SAMPLE_TIME = 5e-5
RATING = (0.0, 150.0)
PEAKS = (50.0, 100.0, 140.0)
"""V, of the held-out loops (paper Figs. 11 to 13)."""
LOW = PEAKS[0]
"""V, up to which the tracking models and G(s) are identified (paper §3.2)."""
TRAINING_PEAK, TRAINING_FREQUENCIES = 145.0, (10.0, 25.0, 75.0, 150.0, 250.0, 350.0, 450.0, 550.0)
"""V and Hz, from which loops of 100 and 140 V are foretold: no loop of Table 4 is among them."""
SEQUENCE_CYCLES = 3
"""Of the quasi-static loop: after one cycle alone the first rise from the virgin state weighs a half."""
MODELS: dict[str, dict[str, Any]] = {"hapi": {}, "rdpi": {}, "hampi": {"levels": False}}  # The paper's has one k for all weights
CYCLES = 12
STROKE, OFFSET = 4.0, 1.0
"""um, peak to peak, and the lowest point of the reference: a drive that is never negative cannot bring the actuator back to 0."""
ACTUATOR = Machine("pea", "hampi_feedforward", RATING, SAMPLE_TIME)
SECOND = replace(ACTUATOR, plant="third")
SEED = 4040


@dataclass(frozen=True)
class Extent:
    """Selection of what is run."""

    frequencies: tuple[float, ...] = GIVEN["frequencies"]  # Frequencies of the held-out loops, Hz
    peaks: tuple[float, ...] = PEAKS  # Peaks of the held-out loops, V
    lags: tuple[float, ...] = tuple(GIVEN["table_1"])  # Frequencies at which phase lags are measured, Hz
    tracked: tuple[float, ...] = tuple(GIVEN["table_5"]["HAMPI"])  # Frequencies of the tracked reference, Hz
    excitation: tuple[tuple[str, Any], ...] = ()  # Options of the excitation, name and value
    methods: tuple[str, ...] = ("joint", "paper")  # Identification methods whose models track
    margins: bool = True  # True to measure the feedback's margins
    second_truth: bool = True  # True to run the second truth plant too


def run(figures: str | None = None, extent: Extent | None = None) -> Table:
    """Record, identify, score and track, and return the table."""
    extent = extent or Extent()
    table = Table("reproduce hampi")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        low = ACTUATOR.record(folder / "low", identification(LOW, extent), SEED + 1)
        steps = ACTUATOR.record(folder / "sequence", paper_sequence(LOW, extent), SEED + 5)
        loops, places = held_out_loops(extent)
        held_out = ACTUATOR.record(folder / "held_out", loops, SEED + 2)
        harmonics, beats = harmonic_drive(extent)
        lagging = ACTUATOR.record(folder / "harmonics", harmonics, SEED + 3)

        sequence = in_sequence(steps)
        joint = {family.upper(): identify([low], family, **MODELS[family]).model for family in ("hapi", "hampi")}
        wide: dict[str, Model] = {}
        wide_sequence: dict[str, Model] = {}
        if extent.peaks[-1] > LOW:
            training = ACTUATOR.record(folder / "training", training_drive(extent), SEED)
            wide_steps = ACTUATOR.record(folder / "wide_sequence", paper_sequence(TRAINING_PEAK, extent), SEED + 6)
            wide = {family.upper(): identify([training], family, **options).model for family, options in MODELS.items()}
            wide_sequence = in_sequence(wide_steps, ("hapi", "hampi"))
        known = {"joint": joint, "paper": sequence}
        compensated = {f"{name}, {method}": known[method][name] for name in ("HAPI", "HAMPI") for method in extent.methods}
        reference, parts = tracking_reference(extent)
        tracked = {
            name: track(folder / name.replace(", ", "_"), name.split(",")[0].lower(), model, reference, ACTUATOR)
            for name, model in compensated.items()
        }
        if extent.second_truth:
            second_truth(table, folder / "second", extent)

    linear = sequence["HAPI"]
    at_low = [place for place in places if place.height == LOW]
    above = [place for place in places if place.height > LOW]
    hampi_tables.phase_lags(table, linear, lagging, beats)
    hampi_tables.step_fit(table, linear, steps)
    hampi_tables.bode(table, linear)
    hampi_tables.dynamic_weights(table, sequence["HAMPI"])
    hampi_tables.inverses(table, linear, SAMPLE_TIME)
    hampi_tables.predictions(table, sequence, held_out, at_low)
    hampi_tables.predictions(table, wide, held_out, above)
    hampi_tables.rotation(table, wide or sequence, held_out, above or at_low)
    if "paper" in extent.methods:
        hampi_tables.methods(table, joint, sequence, held_out, at_low)
        hampi_tables.methods(table, wide, wide_sequence, held_out, above)
        hampi_tables.pooled(table, [(joint, sequence, at_low), (wide, wide_sequence, above)], held_out)
    hampi_tables.tracking(table, tracked, parts, STROKE)
    hampi_tables.attenuation(table, tracked, parts, SAMPLE_TIME)
    if extent.margins:
        robustness(table, tune(wide["HAMPI"]), "pea", "HAMPI model: feedback tuned on it")
    table.notes += [*HAMPI.notes, *HAMPI.not_scored]
    if figures is not None:
        write_page(figures, table)
    return table


def second_truth(table: Table, folder: Path, extent: Extent) -> None:
    """Add Fig. 11 and Table 5 for a reference simulation without a drag of its polarization (`third`), by the paper's sequence."""
    steps = SECOND.record(folder / "sequence", paper_sequence(LOW, extent), SEED + 7)
    loops, places = held_out_loops(replace(extent, peaks=(LOW,)))
    held_out = SECOND.record(folder / "held_out", loops, SEED + 8)
    models = in_sequence(steps)
    reference, parts = tracking_reference(extent)
    tracked = {f"{name}, paper": track(folder / name, name.lower(), models[name], reference, SECOND) for name in ("HAPI", "HAMPI")}
    hampi_tables.predictions(table, models, held_out, places, "HAMPI second truth, Fig. 11")
    hampi_tables.tracking(table, tracked, parts, STROKE, "HAMPI second truth, Table 5")


def in_sequence(data: Record, families: Sequence[str] = ("hapi", "rdpi", "hampi")) -> dict[str, Model]:
    """Identify models by the paper's own steps; RDPI, which has no steps, from the same records at once."""
    return {family.upper(): identify([data], family, "joint" if family == "rdpi" else "paper").model for family in families}


def paper_sequence(peak: float, extent: Extent) -> Annotated[Array, "N 1"]:
    """Build the drive of paper §3.2 alone: a step of 10 V, loops of 1 Hz and loops of 100 Hz up to the peak."""
    ts, slow = SAMPLE_TIME, dict(extent.excitation).get("quasi_static", 1.0)
    step = excitation.rest(ts, 0.02), excitation.rest(ts, 0.15, 10.0), excitation.rest(ts, 0.1)
    loops = excitation.loops(ts, slow, peak, SEQUENCE_CYCLES), excitation.rest(ts, 0.05), excitation.loops(ts, 100.0, peak, CYCLES)
    return np.concatenate([*step, *loops, excitation.rest(ts, 0.05)])[:, None]


def training_drive(extent: Extent) -> Annotated[Array, "N 1"]:
    """Build the excitation of the models that predict loops of 100 and 140 V."""
    return identification(TRAINING_PEAK, replace(extent, excitation=(*extent.excitation, ("frequencies", TRAINING_FREQUENCIES))))


def identification(peak: float, extent: Extent) -> Annotated[Array, "N 1"]:
    """Build the excitation of paper §3.2."""
    drive = {"signal": "hampi_identification", "peak": peak, "fast_share": 1.0, "lower": RATING[0], "upper": RATING[1]}
    return excitation.build({**drive, **dict(extent.excitation)}, SAMPLE_TIME)


def held_out_loops(extent: Extent) -> tuple[Array, list[Place]]:
    """Build loops of every height at every frequency, with rests between."""
    driven = product(extent.peaks, extent.frequencies)
    return _between_rests(
        [(peak, f, excitation.loops(SAMPLE_TIME, f, peak, CYCLES), round(SCORED_CYCLES / f / SAMPLE_TIME)) for peak, f in driven]
    )


def harmonic_drive(extent: Extent) -> tuple[Array, list[Place]]:
    """Build sines of 0 to 50 V (paper Fig. 4, Table 1), of which the second half of each is scored."""
    sines = [excitation.loops(SAMPLE_TIME, frequency, LOW, max(2, round(0.05 * frequency))) for frequency in extent.lags]
    return _between_rests([(LOW, frequency, sine, _second_half(sine)) for frequency, sine in zip(extent.lags, sines, strict=True)])


def tracking_reference(extent: Extent) -> tuple[Array, list[Place]]:
    """Build the reference: up to its top and down to its offset once, then sines at every frequency."""
    ts, top = SAMPLE_TIME, OFFSET + STROKE
    lead = [excitation.rest(ts, 0.02), excitation.cosine_ramp(ts, 0.0, top, 0.1), excitation.cosine_ramp(ts, top, OFFSET, 0.1)]
    sines = [OFFSET + excitation.loops(ts, frequency, STROKE, max(4, round(0.08 * frequency))) for frequency in extent.tracked]
    scored = [(STROKE, frequency, sine, _second_half(sine)) for frequency, sine in zip(extent.tracked, sines, strict=True)]
    return _between_rests(scored, lead, OFFSET)


def _second_half(signal: Array) -> int:
    """Rows of the second half of a signal."""
    return len(signal) - len(signal) // 2


def _between_rests(
    waves: Sequence[tuple[float, float, Array, int]], lead: Sequence[Array] = (), level: float = 0.0
) -> tuple[Array, list[Place]]:
    """Waves one after another behind a lead, a rest at a level before and behind each, and where each is scored."""
    rest = excitation.rest(SAMPLE_TIME, 0.02, level)
    pieces, places = [*lead, rest], []
    for peak, frequency, wave, scored in waves:
        end = sum(map(len, pieces)) + len(wave)
        places.append(Place(peak, frequency, end - scored, end))
        pieces += [wave, rest]
    return np.concatenate(pieces)[:, None], places


def track(folder: Path, kind: str, model: Model, reference: Annotated[Array, "N 1"], machine: Machine) -> dict[str, Array]:
    """Run one open-loop tracking experiment with a compensator."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "model.yaml"
    save_model(model, path)
    preview = build_compensator(model, kind, sample_time=SAMPLE_TIME, limits=RATING).preview
    return machine.track(folder, reference, {"kind": kind, "model": str(path)}, {}, preview, {"seed": SEED + 4})
