# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drawings of recorded signals: over time, one over another, and as spectra; as a picture or as a zoomable page.

A drawing is described once, as `Panel`s of `Line`s, and drawn by matplotlib for pictures or by Plotly for pages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import replacing
from hyst_control.records.record import Record, Signal
from hyst_control.reporting.html_page import COLORS, Page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_POINTS = 4000
"""Points of a line; of longer signals the lowest and highest of every stretch are drawn."""
PICTURES = ("png", "svg", "pdf")
SEGMENTS = 8
"""Parts of a record whose spectra are averaged, at least."""


@dataclass(frozen=True)
class Line:
    """One curve."""

    name: str  # What it shows
    # x, y: Points (N,)
    x: Annotated[Array, "N"]
    y: Annotated[Array, "N"]
    dots: bool = False  # Drawn as dots


@dataclass(frozen=True)
class Panel:
    """One pair of axes with its curves."""

    # x_title, y_title: Titles of the axes, with units
    x_title: str
    y_title: str
    lines: tuple[Line, ...]  # The curves
    logarithmic: str = ""  # Axes with a logarithmic scale: "x" or "xy"
    y_range: tuple[float, float] | None = None  # Ends of the vertical axis; None: those of the curves


def over_time(record: Record) -> list[Panel]:
    """Draw every signal over time, signals of the same unit together."""
    panels = []
    for unit in dict.fromkeys(signal.unit for signal in record.signals.values()):
        lines = [
            Line(name, *thinned(signal.time, column))
            for topic, signal in record.signals.items()
            if signal.unit == unit
            for name, column in _columns(topic, signal)
        ]
        panels.append(Panel("time [s]", f"[{unit}]", tuple(lines)))
    return panels


def over_each_other(record: Record, horizontal: str, vertical: str) -> list[Panel]:
    """Draw one signal over another, axis by axis: hysteresis loops, paths."""
    topics = [name.partition(".")[0] for name in (horizontal, vertical)]
    pieces = record.aligned(list(dict.fromkeys(topics)), allow_gaps=True)
    picked: list[tuple[str, list[str], Array]] = []
    for name, topic in zip((horizontal, vertical), topics, strict=True):
        signal = record.signal(topic)
        values = np.concatenate([piece.values[topic] for piece in pieces])
        axis = name.partition(".")[2]
        if axis and axis not in signal.axes:
            raise InputError(f"{record.source}: {topic} has no axis {axis}, its axes are {', '.join(signal.axes)}")
        chosen = [signal.axes.index(axis)] if axis else list(range(len(signal.axes)))
        names = [name for name, _ in _columns(topic, signal)]
        picked.append((signal.unit, [names[i] for i in chosen], values[:, chosen]))
    (x_unit, x_names, x), (y_unit, y_names, y) = picked
    if x.shape[1] != y.shape[1]:
        raise InputError(f"{horizontal} has {x.shape[1]} axes, {vertical} {y.shape[1]}: name one of each, as measurement.x")
    step = max(1, len(x) // (10 * MAX_POINTS))  # a loop has no order in x: no point of it may be moved
    return [
        Panel(f"{x_names[i]} [{x_unit}]", f"{y_names[i]} [{y_unit}]", (Line(y_names[i], x[::step, i], y[::step, i]),))
        for i in range(x.shape[1])
    ]


def spectra(record: Record) -> list[Panel]:
    """Draw the amplitude spectral density of every signal (Welch's method, Hann windows), signals of the same unit together."""
    from scipy.signal import welch  # takes a second

    record.check(list(record.signals))
    panels = []
    for unit in dict.fromkeys(signal.unit for signal in record.signals.values()):
        lines = []
        for topic, signal in record.signals.items():
            if signal.unit != unit or len(signal.time) < SEGMENTS:
                continue
            rate = 1.0 / float(np.median(np.diff(signal.time)))
            for name, column in _columns(topic, signal):
                frequency, density = welch(column, rate, nperseg=max(2, 2 * len(column) // SEGMENTS), detrend="constant")
                lines.append(Line(name, *thinned(frequency[1:], np.sqrt(density[1:]))))
        panels.append(Panel("frequency [Hz]", f"[{unit}/√Hz]", tuple(lines), "xy"))
    return panels


def thinned(x: Annotated[Array, "N"], y: Annotated[Array, "N"], most: int = MAX_POINTS) -> tuple[Array, Array]:
    """Thin a curve out for a drawing: of every stretch the lowest and the highest point stay."""
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    kept = []
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        part = y[begin:end]
        kept += sorted({begin + int(part.argmin()), begin + int(part.argmax())})
    return x[kept], y[kept]


def write_drawing(panels: Sequence[Panel], path: str | Path, title: str) -> None:
    """Draw panels to a file, whose ending says how: a picture (.png, .svg, .pdf) or a page (.html)."""
    ending = Path(path).suffix.lstrip(".").lower()
    if ending == "html":
        _write_page(panels, Path(path), title)
    elif ending in PICTURES:
        _write_picture(panels, Path(path), title, ending)
    else:
        raise InputError(f"{path}: its ending says what is drawn: .html or .{', .'.join(PICTURES)}")


def _columns(topic: str, signal: Signal) -> list[tuple[str, Array]]:
    several = len(signal.axes) > 1
    return [(f"{topic}.{axis}" if several else topic, signal.values[:, index]) for index, axis in enumerate(signal.axes)]


def draw(panels: Sequence[Panel], figure: Figure, title: str) -> list[Axes]:
    """Draw panels below each other into a figure of matplotlib; the axes, one a panel."""
    figure.set_size_inches(9.0, 1.0 + 3.2 * len(panels))
    figure.set_layout_engine("constrained")
    figure.suptitle(title)
    drawn = list(figure.subplots(len(panels), squeeze=False)[:, 0])
    for panel, axes in zip(panels, drawn, strict=True):
        for index, line in enumerate(panel.lines):
            look = {"marker": ".", "linestyle": "", "markersize": 3.0} if line.dots else {"linewidth": 1.0}
            axes.plot(line.x, line.y, color=COLORS[(index + 1) % len(COLORS)], label=line.name, **look)
        axes.set(xlabel=panel.x_title, ylabel=panel.y_title)
        axes.set(**{f"{axis}scale": "log" for axis in panel.logarithmic}, ylim=panel.y_range)
        if len(panel.lines) > 1:
            axes.legend(loc="best", frameon=False)
        axes.grid(alpha=0.3)
    return drawn


def _write_picture(panels: Sequence[Panel], path: Path, title: str, ending: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    FigureCanvasAgg(figure)
    draw(panels, figure, title)
    with replacing(path) as file:
        figure.savefig(file, format=ending, dpi=120)


def _write_page(panels: Sequence[Panel], path: Path, title: str) -> None:
    import plotly.graph_objects as go

    page = Page(title, "")
    for panel in panels:
        figure = go.Figure()
        for index, line in enumerate(panel.lines):
            colour = COLORS[(index + 1) % len(COLORS)]
            look = (
                {"mode": "markers", "marker": {"color": colour, "size": 4}}
                if line.dots
                else {"line": {"color": colour, "width": 1.3}}
            )
            figure.add_trace(go.Scattergl(x=line.x, y=line.y, name=line.name, **look))
        scales = {axis: "log" if axis in panel.logarithmic else "linear" for axis in "xy"}
        figure.update_xaxes(title_text=panel.x_title, type=scales["x"])
        figure.update_yaxes(title_text=panel.y_title, type=scales["y"], range=panel.y_range)
        page.figure(figure)
    page.write(path)
