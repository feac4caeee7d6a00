# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The HAMPI paper's figures as one zoomable page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from evaluation.reproduction import hampi_tables
from evaluation.reproduction.hampi_tables import Place
from evaluation.reproduction.mhl_figures import line
from hyst_control.base.arrays import Array, Complex
from hyst_control.identify.data.dataset import Dataset
from hyst_control.model_file import Model, simulate
from hyst_control.records.excitation import excitation
from hyst_control.reporting.html_page import Page
from hyst_control.reporting.table_page import add_tables
from hyst_control.reporting.tables import Table

BODE = np.geomspace(1.0, 1000.0, 400)
"""Hz."""


def write(
    folder: Path,
    table: Table,
    linear: Model,
    models: Mapping[str, Model],
    low_models: Mapping[str, Model],
    records: Mapping[str, Dataset],
    places: Sequence[Place],
    tracked: Mapping[str, Mapping[str, Array]],
    parts: Sequence[Place],
) -> None:
    """Write the page of figures, `hampi.html`."""
    folder.mkdir(parents=True, exist_ok=True)
    page = Page(
        "HAMPI: modeling and feedforward control of a piezo actuator",
        "The paper's experiments on a truth actuator whose "
        "physics is not the model's; every signal went over ROS 2 topics in lockstep. The published figures are of the paper's "
        "own actuator.",
    )
    page.section("Fig. 2: step response", "10 V; G(s) identified from it in the paper's first step.")
    page.figure(step(linear, records["low"]))
    page.section("Fig. 3: Bode diagram of G(s)")
    page.figure(bode({"G(s)": hampi_tables.response(linear, BODE)}))
    page.section("Fig. 6: HAPI and HAMPI at different rates", "Loops of 140 V from the two models.")
    page.figure(rates(models))
    page.section("Fig. 8: approximate inverses", "Inverse times G(s), preview taken out.")
    page.figure(bode(hampi_tables.compensated(linear, linear.sample_time, BODE)))
    for number, height in zip((11, 12, 13), sorted({place.height for place in places}), strict=False):
        page.section(f"Fig. {number}: loops of {height:g} V", "Held out: measured and simulated.")
        shown, own = low_models if number == 11 else models, [place for place in places if place.height == height]
        page.figure(loops(shown, records["held_out"], own), 640)
    page.section("Fig. 14: accuracy", "NRMSE of Table 4.")
    page.figure(accuracy(table))
    page.section("Fig. 15: tracking", "Reference, displacement and error, open loop; the last cycles.")
    page.figure(tracking(tracked, parts), 640)
    page.section("Fig. 16: displacement over reference", "The straighter, the better compensated.")
    page.figure(linearity(tracked, parts), 560)
    add_tables(page, table)
    for note in table.notes:
        page.note(note)
    page.write(folder / "hampi.html")


def step(model: Model, data: Dataset) -> go.Figure:
    """Draw Fig. 2: the measured step and that of G(s)."""
    time, measured, answer = hampi_tables.step_response(model, data)
    figure = go.Figure([line(time, measured, "measured", 0), line(time, answer, "G(s)", 1)])
    return figure.update_xaxes(title="s").update_yaxes(title="um")


def bode(responses: Mapping[str, Complex]) -> go.Figure:
    """Draw Bode diagrams over the frequencies of `BODE`."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=("gain [dB]", "phase [deg]"))
    for colour, (name, value) in enumerate(responses.items()):
        figure.add_trace(line(BODE, 20 * np.log10(np.abs(value)), name, colour), 1, 1)
        figure.add_trace(line(BODE, np.degrees(np.unwrap(np.angle(value))), name, colour, legend=False), 1, 2)
    return figure.update_xaxes(type="log", title="Hz")


def rates(models: Mapping[str, Model]) -> go.Figure:
    """Draw Fig. 6: simulated loops of 140 V at four frequencies, HAPI beside HAMPI."""
    names = ("HAPI", "HAMPI")
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, subplot_titles=names)
    for column, name in enumerate(names, start=1):
        model = models[name]
        for colour, frequency in enumerate((50.0, 100.0, 300.0, 500.0)):
            drive = excitation.loops(model.sample_time, frequency, 140.0, 6)[:, None]
            last = int(round(1.0 / frequency / model.sample_time)) + 1
            figure.add_trace(
                line(drive[-last:, 0], simulate(model, drive)[-last:, 0], f"{frequency:g} Hz", colour, legend=column == 1),
                1,
                column,
            )
    return figure.update_xaxes(title="V").update_yaxes(title="um", col=1)


def loops(models: Mapping[str, Model], data: Dataset, places: Sequence[Place]) -> go.Figure:
    """Draw the last loop of every place, measured and simulated."""
    titles = [f"{place.frequency:g} Hz" for place in places]
    figure = make_subplots(rows=2, cols=3, shared_xaxes=True, shared_yaxes=True, subplot_titles=titles)
    simulated = {name: simulate(model, data.command, data.sample_time, data.hold)[:, 0] for name, model in models.items()}
    for index, place in enumerate(places):
        at = (index // 3 + 1, index % 3 + 1)
        rows = slice(place.end - int(round(1.0 / place.frequency / data.sample_time)), place.end)
        figure.add_trace(line(data.command[rows, 0], data.measurement[rows, 0], "measured", 0, legend=index == 0), *at)
        for colour, (name, values) in enumerate(simulated.items(), start=1):
            figure.add_trace(line(data.command[rows, 0], values[rows], name, colour, legend=index == 0, dash="dash"), *at)
    return figure.update_xaxes(title="V", row=2).update_yaxes(title="um", col=1)


def accuracy(table: Table) -> go.Figure:
    """Draw Fig. 14: the NRMSE of Table 4 beside the published one."""
    rows = [row for row in table.rows if row.table == "HAMPI Table 4" and row.quantity == "nrmse"]
    figure = go.Figure()
    for name in dict.fromkeys(row.subject for row in rows):
        own = [row for row in rows if row.subject == name]
        figure.add_trace(go.Bar(x=[row.case for row in own], y=[row.value for row in own], name=name))
        figure.add_trace(
            go.Bar(x=[row.case for row in own], y=[row.published for row in own], name=f"{name}, published", opacity=0.4)
        )
    return figure.update_yaxes(title="NRMSE [%]")


def tracking(tracked: Mapping[str, Mapping[str, Array]], parts: Sequence[Place]) -> go.Figure:
    """Draw Fig. 15: reference, displacement and error over time."""
    figure = make_subplots(rows=2, cols=len(parts), subplot_titles=[f"{part.frequency:g} Hz" for part in parts])
    for column, part in enumerate(parts, start=1):
        time = np.arange(part.end - part.begin)
        reference = next(iter(tracked.values()))["reference"][part.rows, 0]
        figure.add_trace(line(time, reference, "reference", 0, legend=column == 1), 1, column)
        for colour, (name, signals) in enumerate(tracked.items(), start=1):
            measured = signals["measurement"][part.rows, 0]
            figure.add_trace(line(time, measured, name, colour, legend=column == 1), 1, column)
            figure.add_trace(line(time, measured - reference, name, colour, legend=False), 2, column)
    figure.update_yaxes(title="um", row=1, col=1).update_yaxes(title="error [um]", row=2, col=1)
    return figure.update_xaxes(title="tick", row=2)


def linearity(tracked: Mapping[str, Mapping[str, Array]], parts: Sequence[Place]) -> go.Figure:
    """Draw Fig. 16: displacement over reference."""
    figure = make_subplots(rows=1, cols=len(parts), shared_yaxes=True, subplot_titles=[f"{part.frequency:g} Hz" for part in parts])
    for column, part in enumerate(parts, start=1):
        for colour, (name, signals) in enumerate(tracked.items(), start=1):
            figure.add_trace(
                line(signals["reference"][part.rows, 0], signals["measurement"][part.rows, 0], name, colour, legend=column == 1),
                1,
                column,
            )
    return figure.update_xaxes(title="reference [um]").update_yaxes(title="displacement [um]", col=1)
