# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's figures, as SVG files and in its report: loops at several rates, tracking, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import matplotlib
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hyst_control.base.arrays import Array
from hyst_control.diagnose.report.document import named, sentence
from hyst_control.identify.data.fit import Fit
from hyst_control.identify.data.record_segmentation import stretches_between_rests
from hyst_control.identify.workflow import gapless_records
from hyst_control.model_file import simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record
from hyst_control.reporting.html_page import Page, Palette
from hyst_control.reporting.provenance import Origin
from hyst_control.reporting.quantities import quantity
from hyst_control.reporting.tables import Table

matplotlib.use("Agg")
from matplotlib import pyplot

LOOP_FREQUENCIES = (1.0, 50.0, 100.0, 300.0)
MAX_POINTS = 700  # Points of a curve on the page, about; the curves are smooth
PALETTE = Palette("measured", "HAPI", "HAMPI", "HAMPI + PI", "static gain", "PI feedback", "reference")
"""Every subject has one color in all figures; what is asked for has that of what was measured."""
SMALLEST = 1e-3  # um, of the errors that are drawn, on a logarithmic scale on which the controllers differ


Loops = Mapping[float, Mapping[str, tuple[Array, Array]]]  # By frequency and source, command and displacement of a loop


@dataclass(frozen=True)
class Tracked:
    """Tracking of a reference by several controllers."""

    sample_time: float
    reference: Annotated[Array, "N 1"]
    measured: Mapping[str, Mapping[str, Array]]  # By controller, signals (N, 1)
    stretches: Sequence[tuple[float, int, int]]  # Frequency, begin and end of what is drawn


def write(
    folder: Path,
    excitation: Path,
    fits: Mapping[str, Fit],
    tracked: Tracked,
    table: Table,
    gap: Mapping[str, Any],
    origins: Sequence[Origin],
) -> None:
    """Write `figures/*.svg` and `report.html` into the demo's folder."""
    loops = _loops(gapless_records(read_bag(excitation))[0], fits)
    (folder / "figures").mkdir()
    _draw_loops(folder / "figures" / "loops.svg", loops)
    _draw_tracking(folder / "figures" / "tracking.svg", tracked, error=False)
    _draw_tracking(folder / "figures" / "error.svg", tracked, error=True)
    report_page(loops, fits, tracked, table, gap, origins).write(folder / "report.html")


def _loops(data: Record, fits: Mapping[str, Fit]) -> dict[float, dict[str, tuple[Array, Array]]]:
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


def report_page(
    loops: Loops, fits: Mapping[str, Fit], tracked: Tracked, table: Table, gap: Mapping[str, Any], origins: Sequence[Origin]
) -> Page:
    """The page of a demo's results."""
    page = Page("Feedforward of a piezo stage with hysteresis", _verdict(table, gap), origins)
    page.note(
        "A reference simulation, which shares no code with the models, was excited, recorded, identified and made to track a 4 um "
        "reference at four frequencies; then it was changed, recorded and diagnosed. With ROS 2 every signal goes over "
        "topics; without, the same numbers are computed in one process."
    )
    cases = list(dict.fromkeys(row.case for row in table.rows))
    subjects = list(dict.fromkeys(row.subject for row in table.rows))
    values = {(row.case, row.subject): row for row in table.rows if row.quantity == "nrmse"}
    page.section(
        "Tracking error",
        "NRMSE in % of the reference's range (HAMPI paper Eq. 26). The published figures are of another "
        "actuator, in hardware; the plant here is a simulation of one like it.",
    )
    page.figure(_error_figure(table), 420)
    published = ("HAPI", "HAMPI")
    rows = [
        [case, *(f"{values[case, of].value:.2f}" for of in subjects), *(f"{values[case, of].published:.2f}" for of in published)]
        for case in cases
    ]
    groups = [("", 1), ("simulated actuator", len(subjects)), ("published, another actuator", 2)]
    page.table(["frequency", *subjects, *published], rows, groups=groups)
    page.note(
        "PI feedback is the same feedback without a feedforward, HAMPI the feedforward without feedback. Static gain: the reference "
        "divided by the model's mean gain, without feedback."
    )
    page.note(
        "Left the displacement, in the middle the size of its error on a logarithmic scale, on the right the drive voltage that each "
        "controller asks for."
    )
    page.figure(_tracking_figure(tracked), 960, 900)
    page.section(
        "Hysteresis at each frequency",
        "Displacement over drive, measured on the excitation record and simulated by the identified models; beneath, by how much each "
        "model misses the measured curve.",
    )
    page.figure(_loop_figure(loops), 640, 900)
    page.section(
        "Identified models", "Fitted to the excitation record; held-out blocks took no part in the choice of the structure."
    )
    page.table(
        ["model", "dynamics", "NRMSE, record", "NRMSE, held out"],
        [
            [name.upper(), of["structure"][0], f"{of['records'][0]['nrmse']:.3f} %", f"{of['held_out_nrmse'][0]:.3f} %"]
            for name, of in ((name, fit.report) for name, fit in fits.items())
        ],
    )
    page.section(
        "An effect that the model does not know",
        f"The actuator was given {_withheld(gap)}, and the diagnosis was not told. The page gap.html beside this one shows what it found.",
    )
    page.note(sentence(dict(gap)))
    page.table(
        ["effect", "probability", "parameters", "reduction after re-fitting"],
        [
            [
                effect["name"].replace("_", " "),
                f"{effect['probability']:.2f}",
                "; ".join(f"{name} {quantity(row['value'], row['unit'], 4)}" for name, row in effect["parameters"].items()),
                "–" if effect["shrink_reidentified"] is None else f"{100 * effect['shrink_reidentified']:.1f} %",
            ]
            for effect in gap["effects"]
        ],
    )
    return page


def _verdict(table: Table, gap: Mapping[str, Any]) -> str:
    """Result of the demo in one sentence."""
    errors = {
        subject: [row.value for row in table.rows if (row.subject, row.quantity) == (subject, "nrmse")]
        for subject in ("static gain", "HAMPI", "PI feedback", "HAMPI + PI")
    }
    ranges = {subject: f"{min(values):.2g} to {max(values):.2g} %" for subject, values in errors.items()}
    named = gap["verdict"] == "effect" and gap["effects"][0]["name"] == gap["withheld"]["name"]
    found = "was named" if named else f"was not named: the verdict is {gap['verdict'].replace('_', ' ')}"
    return (
        f"With a static gain the stage misses its reference by {ranges['static gain']} of the range, with the identified model as "
        f"feedforward by {ranges['HAMPI']}, with feedback besides by {ranges['HAMPI + PI']}, and with that feedback alone by "
        f"{ranges['PI feedback']}; an effect that was put into the actuator afterwards {found}."
    )


def _withheld(gap: Mapping[str, Any]) -> str:
    values = {name: {"value": value, "unit": "V/s"} for name, value in gap["withheld"].items() if name != "name"}
    return named({"name": gap["withheld"]["name"], "parameters": values})


def _error_figure(table: Table) -> go.Figure:
    """Tracking error of every controller over frequency, and the published ones, on a logarithmic scale."""
    figure = go.Figure()
    for published in (False, True):
        found: dict[str, dict[str, float]] = {}
        for row in table.rows:
            value = row.published if published else row.value
            if row.quantity == "nrmse" and value is not None:
                found.setdefault(row.subject, {})[row.case] = value
        for subject, values in found.items():
            figure.add_scatter(
                x=list(values),
                y=list(values.values()),
                name=f"{subject}, published" if published else subject,
                mode="lines+markers",
                line={"color": PALETTE.color(subject), "dash": "dot" if published else "solid"},
                marker={"symbol": "circle-open" if published else "circle", "size": 8},
            )
    figure.update_yaxes(type="log", dtick=1, title_text="NRMSE [%]")
    figure.update_xaxes(title_text="frequency")
    return figure


def _tracking_figure(tracked: Tracked) -> go.Figure:
    drawn = ("displacement [um]", "|error| [um]", "drive [V]")
    titles = [f"{frequency:g} Hz: {what}" for frequency, _, _ in tracked.stretches for what in drawn]
    spacing = {"horizontal_spacing": 0.07, "vertical_spacing": 0.07}
    figure = make_subplots(rows=len(tracked.stretches), cols=3, subplot_titles=titles, **spacing)
    reference = tracked.reference
    for index, (_, begin, end) in enumerate(tracked.stretches, start=1):
        rows = slice(begin, end, max((end - begin) // MAX_POINTS, 1))
        time = (1e3 * tracked.sample_time * np.arange(end - begin)).astype(np.float32)[:: rows.step]
        line = {"color": PALETTE.color("reference"), "dash": "dot"}
        look, shown = {"name": "reference", "legendgroup": "reference", "line": line}, index == 1
        figure.add_scatter(x=time, y=_single(reference[rows]), showlegend=shown, **look, row=index, col=1)
        for name, signals in tracked.measured.items():
            look = {"name": name, "legendgroup": name, "line": {"color": PALETTE.color(name), "width": 1.3}}
            error = np.maximum(np.abs(signals["measurement"][rows] - reference[rows]), SMALLEST)
            curves = (signals["measurement"][rows], error, signals["command"][rows])
            for column, values in enumerate(curves, start=1):
                figure.add_scatter(x=time, y=_single(values), showlegend=shown and column == 1, **look, row=index, col=column)
    figure.update_yaxes(type="log", dtick=1, col=2)
    figure.update_xaxes(title_text="time [ms]", row=len(tracked.stretches))
    figure.update_annotations(font_size=13)
    return figure


def _single(values: Array) -> Array:
    """First axis in single precision, which is more than a picture shows."""
    return values[:, 0].astype(np.float32)


def _loop_figure(loops: Loops) -> go.Figure:
    titles = [f"{frequency:g} Hz" for frequency in loops]
    figure = make_subplots(rows=2, cols=len(loops), shared_xaxes=True, vertical_spacing=0.06, subplot_titles=titles)
    for column, sources in enumerate(loops.values(), start=1):
        _, truth = sources["measured"]
        every = slice(None, None, max(len(truth) // MAX_POINTS, 1))
        for name, (u, y) in sources.items():
            line = {"color": PALETTE.color(name), "width": 1.4, "dash": "solid" if name == "measured" else "dash"}
            look = {"name": name, "legendgroup": name, "line": line, "x": u[every].astype(np.float32)}
            if name != "measured":
                error = (truth - y)[every].astype(np.float32)
                figure.add_scatter(y=error, showlegend=False, **look, row=2, col=column)
            figure.add_scatter(y=y[every].astype(np.float32), showlegend=column == 1, **look, row=1, col=column)
    figure.update_xaxes(title_text="command [V]", row=2)
    figure.update_yaxes(title_text="displacement [um]", row=1, col=1)
    figure.update_yaxes(title_text="measured − model [um]", row=2, col=1)
    return figure


def _draw_loops(path: Path, loops: Loops) -> None:
    figure, axes = pyplot.subplots(1, len(loops), figsize=(3.2 * len(loops), 3.4), sharey=True, squeeze=False)
    for axis, (frequency, sources) in zip(axes[0], loops.items(), strict=True):
        for name, (u, y) in sources.items():
            axis.plot(u, y, color=PALETTE.color(name), linewidth=1.1, linestyle="-" if name == "measured" else "--", label=name)
        axis.set(title=f"{frequency:g} Hz", xlabel="command [V]")
    axes[0][0].set_ylabel("displacement [um]")
    axes[0][0].legend(frameon=False)
    _save(figure, path)


def _draw_tracking(path: Path, tracked: Tracked, error: bool) -> None:
    reference, count = tracked.reference, len(tracked.stretches)
    figure, axes = pyplot.subplots(1, count, figsize=(3.2 * count, 3.4), squeeze=False)
    for axis, (frequency, begin, end) in zip(axes[0], tracked.stretches, strict=True):
        time = 1e3 * tracked.sample_time * np.arange(end - begin)
        if not error:
            axis.plot(time, reference[begin:end], color=PALETTE.color("reference"), linestyle=":", label="reference")
        for name, signals in tracked.measured.items():
            y = signals["measurement"][begin:end, 0]
            y = np.maximum(np.abs(y - reference[begin:end, 0]), SMALLEST) if error else y
            axis.plot(time, y, color=PALETTE.color(name), linewidth=1.0, label=name)
        axis.set(title=f"{frequency:g} Hz", xlabel="time [ms]", yscale="log" if error else "linear")
    axes[0][0].set_ylabel("|error| [um]" if error else "displacement [um]")
    axes[0][-1].legend(frameon=False, fontsize="small")
    _save(figure, path)


def _save(figure: pyplot.Figure, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
