"""The demo's figures, as SVG files and in its report: loops at several rates, tracking, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hyst_control.chain.stage import Array
from hyst_control.identify.dataset import Dataset, Fit
from hyst_control.identify.record_segmentation import stretches_between_rests
from hyst_control.identify.workflow import datasets_of
from hyst_control.model_file import simulate
from hyst_control.records.bag_reader import read_bag
from hyst_control.reporting.html_page import COLORS, Page
from hyst_control.reporting.tables import Table

matplotlib.use("Agg")
from matplotlib import pyplot

LOOP_FREQUENCIES = (1.0, 50.0, 100.0, 300.0)


def write(
    folder: Path,
    excitation: Path,
    fits: Mapping[str, Fit],
    reference: Array,
    measured: Mapping[str, Mapping[str, Array]],
    stretches: Sequence[tuple[float, int, int]],
    table: Table,
) -> None:
    """Write `figures/*.svg` and `report.html` into the demo's folder.

    Parameters
    ----------
    folder : Path
        The demo's folder.
    excitation : Path
        Bag of the excitation run.
    fits : mapping of str to Fit
        Fits by model family.
    reference : ndarray, shape (N, 1)
        Reference, um.
    measured : mapping of str to mapping of str to ndarray
        Signals (N, 1) by controller and name, um or V.
    stretches : sequence of (float, int, int)
        Frequency (Hz), begin and end row of each scored stretch.
    table : Table
        Tracking errors.
    """
    data = datasets_of(read_bag(excitation))[0]
    loops = _loops(data, fits)
    (folder / "figures").mkdir()
    _draw_loops(folder / "figures" / "loops.svg", loops)
    _draw_tracking(folder / "figures" / "tracking.svg", data.sample_time, reference, measured, stretches, error=False)
    _draw_tracking(folder / "figures" / "error.svg", data.sample_time, reference, measured, stretches, error=True)
    _page(loops, data.sample_time, fits, reference, measured, stretches, table).write(folder / "report.html")


def _loops(data: Dataset, fits: Mapping[str, Fit]) -> dict[float, dict[str, tuple[Array, Array]]]:
    """The last loop of full height at each frequency: command and measured or simulated displacement, by source."""
    simulated = {name: simulate(fit.model, data.command, data.sample_time, data.hold)[:, 0] for name, fit in fits.items()}
    found = [stretch for stretch in stretches_between_rests(data, 0, 0) if stretch.kind == "motion"]
    loops: dict[float, dict[str, tuple[Array, Array]]] = {}
    for frequency in LOOP_FREQUENCIES:
        near = [stretch for stretch in found if abs(stretch.frequency / frequency - 1) < 0.05]
        if not near:
            continue
        stretch = max(near, key=lambda item: item.amplitude)
        end = stretch.end
        rows = slice(max(end - int(round(1.0 / frequency / data.sample_time)), stretch.begin), end)
        loops[frequency] = {
            "measured": (data.command[rows, 0], data.measurement[rows, 0]),
            **{name.upper(): (data.command[rows, 0], values[rows]) for name, values in simulated.items()},
        }
    return loops


def _page(
    loops: Mapping[float, Mapping[str, tuple[Array, Array]]],
    sample_time: float,
    fits: Mapping[str, Fit],
    reference: Array,
    measured: Mapping[str, Mapping[str, Array]],
    stretches: Sequence[tuple[float, int, int]],
    table: Table,
) -> Page:
    page = Page(
        "Feedforward of a piezo stage with hysteresis",
        "A truth actuator was excited, recorded, identified and made to track a "
        "4 um reference at four frequencies; every signal went over ROS 2 topics.",
    )
    cases = list(dict.fromkeys(row.case for row in table.rows))
    subjects = list(dict.fromkeys(row.subject for row in table.rows))
    values = {(row.case, row.subject): row for row in table.rows if row.quantity == "nrmse"}
    page.section(
        "Tracking error",
        "NRMSE in % of the reference's range (HAMPI paper Eq. 26). The published figures are of another "
        "actuator, in hardware; the plant here is a simulation of one like it.",
    )
    page.table(
        ["frequency", *subjects, "HAPI, published", "HAMPI, published"],
        [
            [
                case,
                *(f"{values[case, subject].value:.2f}" for subject in subjects),
                *(f"{values[case, subject].published:.2f}" for subject in ("HAPI", "HAMPI")),
            ]
            for case in cases
        ],
    )
    page.figure(_tracking_figure(sample_time, reference, measured, stretches), 900)
    page.section("Loops", "Displacement over drive, measured on the excitation record and simulated by the identified models.")
    page.figure(_loop_figure(loops), 460)
    page.section(
        "Identified models", "Fitted to the excitation record; held-out blocks took no part in the choice of the structure."
    )
    page.table(
        ["model", "dynamics", "NRMSE, record", "NRMSE, held out"],
        [
            [
                name.upper(),
                fit.report["structure"][0],
                f"{fit.report['records'][0]['nrmse']:.3f} %",
                f"{fit.report['held_out_nrmse'][0]:.3f} %",
            ]
            for name, fit in fits.items()
        ],
    )
    return page


def _tracking_figure(
    sample_time: float, reference: Array, measured: Mapping[str, Mapping[str, Array]], stretches: Sequence[tuple[float, int, int]]
) -> go.Figure:
    figure = make_subplots(
        rows=len(stretches),
        cols=2,
        horizontal_spacing=0.08,
        vertical_spacing=0.07,
        subplot_titles=[
            text
            for frequency, _, _ in stretches
            for text in (f"{frequency:g} Hz: displacement [um]", f"{frequency:g} Hz: error [um]")
        ],
    )
    for index, (_, begin, end) in enumerate(stretches, start=1):
        time = 1e3 * sample_time * np.arange(end - begin)
        figure.add_trace(
            go.Scatter(
                x=time,
                y=reference[begin:end, 0],
                name="reference",
                line={"color": COLORS[0], "dash": "dot"},
                legendgroup="reference",
                showlegend=index == 1,
            ),
            index,
            1,
        )
        for colour, (name, signals) in zip(COLORS[1:], measured.items(), strict=False):
            y = signals["measurement"][begin:end, 0]
            look = {"name": name, "line": {"color": colour, "width": 1.3}, "legendgroup": name}
            figure.add_trace(go.Scatter(x=time, y=y, showlegend=index == 1, **look), index, 1)
            figure.add_trace(go.Scatter(x=time, y=y - reference[begin:end, 0], showlegend=False, **look), index, 2)
    figure.update_xaxes(title_text="time [ms]", row=len(stretches))
    return figure


def _loop_figure(loops: Mapping[float, Mapping[str, tuple[Array, Array]]]) -> go.Figure:
    figure = make_subplots(rows=1, cols=len(loops), subplot_titles=[f"{frequency:g} Hz" for frequency in loops])
    for column, (_, sources) in enumerate(loops.items(), start=1):
        for colour, (name, (u, y)) in zip(COLORS, sources.items(), strict=False):
            figure.add_trace(
                go.Scatter(
                    x=u,
                    y=y,
                    name=name,
                    legendgroup=name,
                    showlegend=column == 1,
                    line={"color": colour, "width": 1.4, "dash": "solid" if name == "measured" else "dash"},
                ),
                1,
                column,
            )
    figure.update_xaxes(title_text="command [V]")
    figure.update_yaxes(title_text="displacement [um]", col=1)
    return figure


def _draw_loops(path: Path, loops: Mapping[float, Mapping[str, tuple[Array, Array]]]) -> None:
    figure, axes = pyplot.subplots(1, len(loops), figsize=(3.2 * len(loops), 3.4), sharey=True, squeeze=False)
    for axis, (frequency, sources) in zip(axes[0], loops.items(), strict=True):
        for colour, (name, (u, y)) in zip(COLORS, sources.items(), strict=False):
            axis.plot(u, y, color=colour, linewidth=1.1, linestyle="-" if name == "measured" else "--", label=name)
        axis.set(title=f"{frequency:g} Hz", xlabel="command [V]")
    axes[0][0].set_ylabel("displacement [um]")
    axes[0][0].legend(frameon=False)
    _save(figure, path)


def _draw_tracking(
    path: Path,
    sample_time: float,
    reference: Array,
    measured: Mapping[str, Mapping[str, Array]],
    stretches: Sequence[tuple[float, int, int]],
    error: bool,
) -> None:
    figure, axes = pyplot.subplots(1, len(stretches), figsize=(3.2 * len(stretches), 3.4), squeeze=False)
    for axis, (frequency, begin, end) in zip(axes[0], stretches, strict=True):
        time = 1e3 * sample_time * np.arange(end - begin)
        if not error:
            axis.plot(time, reference[begin:end], color=COLORS[0], linestyle=":", label="reference")
        for colour, (name, signals) in zip(COLORS[1:], measured.items(), strict=False):
            y = signals["measurement"][begin:end, 0] - (reference[begin:end, 0] if error else 0.0)
            axis.plot(time, y, color=colour, linewidth=1.0, label=name)
        axis.set(title=f"{frequency:g} Hz", xlabel="time [ms]")
    axes[0][0].set_ylabel("error [um]" if error else "displacement [um]")
    axes[0][-1].legend(frameon=False, fontsize="small")
    _save(figure, path)


def _save(figure: pyplot.Figure, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
