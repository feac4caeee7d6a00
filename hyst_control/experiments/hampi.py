"""`hyst reproduce hampi`: the HAMPI paper's model comparison on a truth actuator, recorded through the real nodes.

Table 4: HAPI, RDPI and HAMPI, identified jointly from one excitation record up to 140 V, on held-out loops of 140 V at 50 to 500 Hz;
and the joint identification beside the paper's own sequence on the same held-out loops. The published figures are of the paper's
actuator; the plant here is a simulated one like it, whose hysteresis and drag are not the model's own.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from hyst_control import excitation
from hyst_control.bag_reader import read_bag
from hyst_control.chain.stage import Array
from hyst_control.experiments.runs import run_processes
from hyst_control.identify import identify
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.report import residual
from hyst_control.identify.workflow import datasets_of
from hyst_control.model_file import Model
from hyst_control.share import config_path
from hyst_control.tables import Table

SAMPLE_TIME = 5e-5
PEAK = 140.0
"""V, paper §5.1."""
FREQUENCIES = (50.0, 100.0, 200.0, 300.0, 400.0, 500.0)
PUBLISHED = {"HAPI": (3.83, 3.68, 4.71, 4.70, 5.22, 5.58), "RDPI": (1.47, 3.18, 4.75, 6.26, 8.18, 10.44),
             "HAMPI": (2.10, 1.60, 1.26, 1.40, 2.14, 3.07)}
"""NRMSE in %, HAMPI paper Table 4."""
CYCLES = 12
SCORED_CYCLES = 4
SEED = 4040
BLOCK = 500


def run(json_path: str | None = None, figures: str | None = None) -> Table:
    """Record, identify, score; the table."""
    table = Table("reproduce hampi")
    with tempfile.TemporaryDirectory() as folder:
        training = record(Path(folder) / "training", excitation.build(
            {"signal": "hampi_identification", "peak": PEAK, "fast_share": 1.0, "lower": 0.0, "upper": 150.0}, SAMPLE_TIME), SEED)
        loops, places = held_out_loops()
        held_out = record(Path(folder) / "held_out", loops, SEED + 1)
    models = {family.upper(): identify([training], family).model for family in ("hapi", "rdpi", "hampi")}
    for name, model in models.items():
        add_rows(table, "HAMPI Table 4", name, model, held_out, places, PUBLISHED[name])
    for family in ("hapi", "hampi"):
        paper = identify([training], family, "paper").model
        add_rows(table, "joint identification beside the paper's sequence", f"{family.upper()}, paper's sequence", paper, held_out, places)
        add_rows(table, "joint identification beside the paper's sequence", f"{family.upper()}, joint", models[family.upper()], held_out,
                 places)
    if json_path:
        table.write(json_path)
    if figures:
        draw_loops(Path(figures), models, held_out, places)
    return table


def held_out_loops() -> tuple[Array, list[tuple[float, int, int]]]:
    """Loops of full height at every frequency with rests between; and the rows of the last cycles of each."""
    pieces, places = [excitation.rest(SAMPLE_TIME, 0.02)], []
    for frequency in FREQUENCIES:
        begin = sum(len(piece) for piece in pieces)
        wave = excitation.loops(SAMPLE_TIME, frequency, PEAK, CYCLES)
        places.append((frequency, begin + len(wave) - int(round(SCORED_CYCLES / frequency / SAMPLE_TIME)), begin + len(wave)))
        pieces += [wave, excitation.rest(SAMPLE_TIME, 0.02)]
    return np.concatenate(pieces)[:, None], places


def record(folder: Path, signal: Array, seed: int) -> Dataset:
    """An open-loop record of the truth actuator, through the five nodes."""
    bag = run_processes(folder, signal, SAMPLE_TIME, {
        "hampi_feedforward": {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
        "pi_feedback": {"upper": 150.0, "start": "first_command"},
        "plant": {"plant": str(config_path("plants/pea.yaml")), "seed": seed}}, block=BLOCK)
    return datasets_of(read_bag(bag))[0]


def add_rows(table: Table, title: str, subject: str, model: Model, data: Dataset, places: list[tuple[float, int, int]],
             published: tuple[float, ...] | None = None) -> None:
    """NRMSE (% of range, paper Eq. 26) and RMSE at every frequency, means kept."""
    error = residual(model, data)[:, 0]
    for index, (frequency, begin, end) in enumerate(places):
        rmse = float(np.sqrt(np.mean(error[begin:end] ** 2)))
        span = float(np.ptp(data.measurement[begin:end, 0]))
        table.add(title, f"{frequency:g} Hz", subject, "nrmse", "%", 100 * rmse / span,
                  published=published[index] if published else None, n=end - begin)
        table.add(title, f"{frequency:g} Hz", subject, "rmse", data.unit, rmse, n=end - begin)


def draw_loops(folder: Path, models: dict[str, Model], data: Dataset, places: list[tuple[float, int, int]]) -> None:
    """Fig. 13: loops at every frequency, measured and simulated."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from hyst_control.model_file import simulate

    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = pyplot.subplots(2, 3, figsize=(11, 7), sharex=True, sharey=True)
    simulated = {name: simulate(model, data.command, data.sample_time, data.hold)[:, 0] for name, model in models.items()}
    for axis, (frequency, _, end) in zip(axes.ravel(), places, strict=True):
        rows = slice(end - int(round(1.0 / frequency / SAMPLE_TIME)), end)
        axis.plot(data.command[rows, 0], data.measurement[rows, 0], color="#1c2430", label="measured")
        for name, values in simulated.items():
            axis.plot(data.command[rows, 0], values[rows], linewidth=1.0, linestyle="--", label=name)
        axis.set_title(f"{frequency:g} Hz")
    axes[0, 0].legend(frameon=False)
    figure.supxlabel("command [V]")
    figure.supylabel("displacement [um]")
    figure.tight_layout()
    figure.savefig(folder / "hampi_loops_140V.svg")
    pyplot.close(figure)
