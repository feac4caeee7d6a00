# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The MHL paper's figures as one zoomable page: models on held-out records, tracking, closed-loop response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from evaluation.reproduction import mhl_responses, mhl_tables
from hyst_control.base.arrays import Array
from hyst_control.identify.data.dataset import Dataset, Fit
from hyst_control.model_file import simulate
from hyst_control.reporting.html_page import COLORS, Page
from hyst_control.reporting.table_page import add_tables
from hyst_control.reporting.tables import Table

LOOP = 2e-4
SHOWN = (mhl_tables.TRADITIONAL, mhl_tables.PUBLISHED, mhl_tables.MOVED, mhl_tables.AHEAD, "whole inverse")
MOST = 4000
"""Points of a line, at most."""


def write(
    folder: Path,
    table: Table,
    fits: Mapping[str, Fit],
    fine: Fit,
    records: Mapping[str, Dataset],
    places: Sequence[tuple[float, slice, slice]],
    tracked: Mapping[str, Mapping[str, Array]],
    parts: Mapping[str, Any],
) -> None:
    """Write the page of figures, `mhl.html`."""
    folder.mkdir(parents=True, exist_ok=True)
    page = Page(
        "MHL: modeling and control of a fast steering mirror",
        "The paper's experiments on a truth mirror whose physics is not "
        "the model's; every signal went over ROS 2 topics in lockstep. The published figures are of the paper's own mirror.",
    )
    page.section("Fig. 9: slow loops", "Measured and predicted tilt of axis x, 1 Hz, held out.")
    page.figure(prediction(records["static"], dict(fits)))
    page.section("Fig. 10: open-loop response", "Small sweep to 4 kHz, axis x: measured and modelled.")
    page.figure(open_loop(records["fine"], fine))
    page.section("Fig. 11: multi-frequency drive", "15, 40, 75 and 100 Hz, held out.")
    page.figure(prediction(records["multi"], dict(fits)))
    page.section("Figs. 12 and 13: loops at high frequency", "Axis x, 10 V about 50 V; the means of a loop are removed.")
    page.figure(fast_loops(records["fast"], fine, places), 560)
    for number, name in ((14, "single"), (15, "decreasing"), (16, "multi")):
        page.section(f"Fig. {number}: tracking, {name}", "Tilt and error of axis x.")
        page.figure(tracking(tracked, parts[name]), 560)
    page.section("Fig. 14 d: measured over wanted tilt", "100 Hz, the last two cycles.")
    page.figure(linearity(tracked, parts["single"]))
    page.section("Fig. 17: spiral", "Both axes.")
    page.figure(spiral(tracked, parts["spiral"]), 560)
    page.section("Fig. 18: closed-loop response", "From reference to measurement of axis x, small multisine about the middle.")
    page.figure(closed_loop(tracked, parts["response"]), 560)
    add_tables(page, table)
    page.write(folder / "mhl.html")


def line(
    x: NDArray[np.number[Any]], y: Annotated[Array, "N"], name: str, colour: int, *, legend: bool = True, dash: str = "solid"
) -> go.Scatter:
    """Make a line, thinned when it has twice `MOST` points or more."""
    step = max(len(x) // MOST, 1)
    return go.Scatter(
        x=x[::step],
        y=y[::step],
        name=name,
        legendgroup=name,
        showlegend=legend,
        line={"color": COLORS[colour % len(COLORS)], "width": 1.3, "dash": dash},
    )


def prediction(data: Dataset, fits: Mapping[str, Fit]) -> go.Figure:
    """Draw tilt over drive and the prediction errors over time, axis x."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=("tilt over drive [mrad over V]", "error over time [mrad over s]"))
    time = data.sample_time * np.arange(len(data.command))
    figure.add_trace(line(data.command[:, 0], data.measurement[:, 0], "measured", 0), 1, 1)
    for colour, (name, fit) in enumerate(fits.items(), start=1):
        predicted = simulate(fit.model, data.command, data.sample_time)[:, 0]
        figure.add_trace(line(data.command[:, 0], predicted, name, colour, dash="dash"), 1, 1)
        figure.add_trace(line(time, data.measurement[:, 0] - predicted, name, colour, legend=False), 1, 2)
    return figure


def open_loop(data: Dataset, fit: Fit) -> go.Figure:
    """Draw Fig. 10: measured and modeled responses by cross spectra of the last small sweep of axis x."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, subplot_titles=("gain [dB re 1 mrad/V]", "phase [deg]"))
    frequency, measured, modelled = mhl_responses.open_loop_responses(fit.model, data, 0)
    for colour, (name, value) in enumerate((("measured", measured), ("model", modelled))):
        figure.add_trace(line(frequency, 20 * np.log10(np.abs(value)), name, colour), 1, 1)
        figure.add_trace(line(frequency, np.degrees(np.unwrap(np.angle(value))), name, colour, legend=False), 2, 1)
    figure.update_xaxes(type="log", title_text="frequency [Hz]", row=2)
    figure.update_xaxes(type="log", row=1)
    return figure


def fast_loops(data: Dataset, fit: Fit, places: Sequence[tuple[float, slice, slice]]) -> go.Figure:
    """Draw Figs. 12 and 13: the last two loops at every frequency, measured and simulated, means removed."""
    figure = make_subplots(rows=2, cols=3, subplot_titles=[f"{frequency:g} Hz" for frequency, _, _ in places])
    predicted = simulate(fit.model, data.command, data.sample_time)[:, 0]
    for place, (frequency, scored, _) in enumerate(places):
        rows = slice(max(scored.stop - int(round(2.0 / frequency / data.sample_time)), scored.start), scored.stop)
        for colour, (name, y) in enumerate((("measured", data.measurement[:, 0]), ("model", predicted))):
            figure.add_trace(
                line(
                    data.command[rows, 0],
                    y[rows] - y[rows].mean(),
                    name,
                    colour,
                    legend=place == 0,
                    dash="dash" if colour else "solid",
                ),
                place // 3 + 1,
                place % 3 + 1,
            )
    figure.update_xaxes(title_text="drive [V]", row=2)
    figure.update_yaxes(title_text="tilt [mrad]", col=1)
    return figure


def tracking(tracked: Mapping[str, Mapping[str, Array]], part: Any) -> go.Figure:
    """Draw tilt and error of axis x over time."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, subplot_titles=("tilt [mrad]", "error [mrad]"))
    rows = slice(part.begin, part.end)
    time = 1e3 * LOOP * np.arange(part.end - part.begin)
    for colour, name in enumerate(SHOWN, start=1):
        signals = tracked[name]
        if colour == 1:
            figure.add_trace(line(time, signals["reference"][rows, 0], "reference", 0, dash="dot"), 1, 1)
        figure.add_trace(line(time, signals["measurement"][rows, 0], name, colour), 1, 1)
        figure.add_trace(line(time, (signals["measurement"] - signals["reference"])[rows, 0], name, colour, legend=False), 2, 1)
    figure.update_xaxes(title_text="time [ms]", row=2)
    return figure


def linearity(tracked: Mapping[str, Mapping[str, Array]], part: Any) -> go.Figure:
    """Draw Fig. 14 d: measured over wanted tilt of axis x, the last 100 samples."""
    figure = go.Figure()
    rows = slice(part.end - 100, part.end)
    for colour, name in enumerate(SHOWN, start=1):
        figure.add_trace(line(tracked[name]["reference"][rows, 0], tracked[name]["measurement"][rows, 0], name, colour))
    figure.update_xaxes(title_text="wanted [mrad]")
    figure.update_yaxes(title_text="measured [mrad]")
    return figure


def spiral(tracked: Mapping[str, Mapping[str, Array]], part: Any) -> go.Figure:
    """Draw Fig. 17: the spiral, and the error of both axes over time."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=("y over x [mrad]", "error over time, both axes [mrad over ms]"))
    rows = slice(part.begin, part.end)
    time = 1e3 * LOOP * np.arange(part.end - part.begin)
    for colour, name in enumerate(SHOWN, start=1):
        measured, wanted = tracked[name]["measurement"][rows], tracked[name]["reference"][rows]
        if colour == 1:
            figure.add_trace(line(wanted[:, 0], wanted[:, 1], "reference", 0, dash="dot"), 1, 1)
        figure.add_trace(line(measured[:, 0], measured[:, 1], name, colour), 1, 1)
        for axis in range(2):
            figure.add_trace(
                line(time, (measured - wanted)[:, axis], name, colour, legend=False, dash=("solid", "dot")[axis]), 1, 2
            )
    return figure


def closed_loop(tracked: Mapping[str, Mapping[str, Array]], part: Any) -> go.Figure:
    """Draw Fig. 18: the closed-loop response of axis x."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, subplot_titles=("gain [dB]", "phase [deg]"))
    for colour, name in enumerate(SHOWN, start=1):
        frequency, value = mhl_responses.response(tracked[name], part, LOOP)
        figure.add_trace(line(frequency, 20 * np.log10(np.abs(value)), name, colour), 1, 1)
        figure.add_trace(line(frequency, np.degrees(np.unwrap(np.angle(value))), name, colour, legend=False), 2, 1)
    figure.update_xaxes(type="log", title_text="frequency [Hz]", row=2)
    figure.update_xaxes(type="log", row=1)
    return figure
