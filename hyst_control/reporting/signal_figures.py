# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drawings of recorded signals, as `Panel`s of `Line`s: over time, one over another, and as spectra; as a picture or as a zoomable page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import replacing
from hyst_control.records.motion_frequency import motion_frequency
from hyst_control.records.record import Record, Signal
from hyst_control.reporting.html_page import COLORS, Page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_POINTS = 4000  # Points of a line; of longer signals the lowest and highest of every stretch are drawn
PICTURES = ("png", "svg", "pdf")
COLOR_MAP = "viridis"
SEGMENTS = 8  # Parts of a record whose spectra are averaged, at least


QUANTITIES = {
    "V": "voltage", "A": "current", "um": "position", "mrad": "angle", "deg": "angle", "N": "force", "m/s^2": "acceleration",
}  # fmt: skip
"""What a unit measures: the title of an axis."""
FEWEST_FREQUENCIES = 1.5  # Ratio of the highest to the lowest frequency of a motion from which loops are colored by it
COLORINGS = ("record", "time", "frequency")


@dataclass(frozen=True)
class Line:
    """One curve."""

    name: str  # What it shows
    x: Annotated[Array, "N"]
    y: Annotated[Array, "N"]
    dots: bool = False  # Drawn as dots
    marker: str = "."  # Form of the dots: ".", "o" or "x"
    shade: Annotated[Array, "N"] | None = None  # Values > 0 that color its points, on the scale of the panel


@dataclass(frozen=True)
class Panel:
    """One pair of axes with its curves."""

    x_title: str  # Of an axis, with its unit
    y_title: str
    lines: tuple[Line, ...]  # The curves
    logarithmic: str = ""  # Axes with a logarithmic scale: "x" or "xy"
    y_range: tuple[float, float] | None = None  # Ends of the vertical axis; None: those of the curves
    shade_title: str = ""  # Title of the scale of colors, with its unit

    @property
    def shades(self) -> tuple[float, float] | None:
        """Ends of the scale of colors; None where no curve has one."""
        found = np.concatenate([line.shade for line in self.lines if line.shade is not None] or [np.zeros(0)])
        found = found[np.isfinite(found)]
        return (float(found.min()), float(found.max())) if len(found) else None


def axis_title(topic: str, unit: str, axis: str = "") -> str:
    """Title of an axis of a drawing: "voltage [V]" for the command, "position x [um]" for one of several axes."""
    name = QUANTITIES.get(unit, topic) if topic in ("command", "measurement") else topic
    return f"{name} {axis} [{unit}]" if axis else f"{name} [{unit}]"


def over_time(*records: Record) -> list[Panel]:
    """Draw every signal over time, signals of the same unit together."""
    return [
        Panel(
            "time [s]", f"{QUANTITIES.get(unit, '')} [{unit}]".strip(), tuple(Line(name, *thinned(x, y)) for name, x, y in curves)
        )
        for unit, curves in _by_unit(records).items()
    ]


def over_each_other(record: Record, horizontal: str, vertical: str, *others: Record, color: str | None = None) -> list[Panel]:
    """Draw one signal over another, axis by axis and record by record, colored by "record", "time" or "frequency" (None: as fits)."""
    if color not in (None, *COLORINGS):
        raise InputError(f"color: must be one of {', '.join(COLORINGS)}, got {color!r}")
    drawn = [_pairs(each, horizontal, vertical) for each in (record, *others)]
    titles = [(x_title, y_title) for x_title, y_title, *_ in drawn[0]]
    if any([(x_title, y_title) for x_title, y_title, *_ in each] != titles for each in drawn):
        raise InputError(f"{others[0].source}: has other axes or units than {record.source}: draw records of one machine")
    panels = []
    for index, (x_title, y_title) in enumerate(titles):
        pairs = [each[index] for each in drawn]
        shades = _shades(pairs, color, several=len(drawn) > 1)
        lines = tuple(
            Line(each.source if others else y_title.rpartition(" [")[0], x, y, shade=shade)
            for each, (_, _, x, y, _, _), shade in zip((record, *others), pairs, shades, strict=True)
        )
        by = "" if shades[0] is None else "time [s]" if color == "time" else "frequency [Hz]"
        panels.append(Panel(x_title, y_title, lines, shade_title=by))
    return panels


_Pair = tuple[str, str, Array, Array, Array, Array]


def _pairs(record: Record, horizontal: str, vertical: str) -> list[_Pair]:
    """Titles, the two signals, time and frequency of the horizontal one, axis by axis."""
    topics = [name.partition(".")[0] for name in (horizontal, vertical)]
    pieces = record.aligned(list(dict.fromkeys(topics)), allow_gaps=True)
    clock = record.common_step(topics)
    picked: list[tuple[list[str], list[Array]]] = []
    for name, topic in zip((horizontal, vertical), topics, strict=True):
        signal, axis = record.signal(topic), name.partition(".")[2]
        if axis and axis not in signal.axes:
            raise InputError(f"{record.source}: {topic} has no axis {axis}, its axes are {', '.join(signal.axes)}")
        chosen = [signal.axes.index(axis)] if axis else list(range(len(signal.axes)))
        titles = [axis_title(topic, signal.unit, signal.axes[i] if len(signal.axes) > 1 else "") for i in chosen]
        picked.append((titles, [piece.signal(topic).values[:, chosen] for piece in pieces]))
    (x_titles, x), (y_titles, y) = picked
    if len(x_titles) != len(y_titles):
        raise InputError(f"{horizontal} has {len(x_titles)} axes, {vertical} {len(y_titles)}: name one of each, as measurement.x")
    step = max(1, sum(map(len, x)) // (10 * MAX_POINTS))  # a loop has no order in x: no point of it may be moved
    found = []
    for index, (x_title, y_title) in enumerate(zip(x_titles, y_titles, strict=True)):
        frequency = [motion_frequency(part[:, index], clock) for part in x]
        columns = ([part[:, index] for part in x], [part[:, index] for part in y], [piece.time for piece in pieces], frequency)
        one, other, time, at = (np.concatenate(column)[::step] for column in columns)
        found.append((x_title, y_title, one, other, time, at))
    return found


def _shades(pairs: Sequence[_Pair], color: str | None, several: bool) -> list[Array | None]:
    """Values that color the points of each pair; None where records are told apart by their colors."""
    frequencies = [frequency for *_, frequency in pairs]
    known = np.concatenate(frequencies)
    known = known[np.isfinite(known)]
    varied = len(known) > 0 and known.max() > FEWEST_FREQUENCIES * known.min()
    if color == "time":
        return [time for *_, time, _ in pairs]
    if len(known) and (color == "frequency" or color is None and varied and not several):
        return list(frequencies)
    return [None] * len(pairs)


def spectra(*records: Record) -> list[Panel]:
    """Draw the amplitude spectral density of every signal (Welch's method, Hann windows), signals of the same unit together."""
    for record in records:
        record.check(list(record.signals))
    from hyst_control.base.signals import averaged_periodogram  # imports numba

    panels = []
    for unit, curves in _by_unit(records).items():
        lines = []
        for name, time, column in curves:
            if len(time) >= SEGMENTS:
                rate = 1.0 / float(np.median(np.diff(time)))
                frequency, density = averaged_periodogram(column, rate, max(2, 2 * len(column) // SEGMENTS))
                lines.append(Line(name, *thinned(frequency[1:], np.sqrt(density[1:]))))
        panels.append(Panel("frequency [Hz]", f"{QUANTITIES.get(unit, '')} density [{unit}/√Hz]".strip(), tuple(lines), "xy"))
    return panels


def _by_unit(records: Sequence[Record]) -> dict[str, list[tuple[str, Array, Array]]]:
    """Name, times and values of every column, by unit; named with the record where there are several."""
    found: dict[str, list[tuple[str, Array, Array]]] = {}
    for record in records:
        before = f"{record.source}: " if len(records) > 1 else ""
        for topic, signal in record.signals.items():
            own = found.setdefault(signal.unit, [])
            own += [(before + name, signal.time, column) for name, column in columns_of(topic, signal)]
    return found


def thinned(x: Annotated[Array, "N"], y: Annotated[Array, "N"], most: int = MAX_POINTS) -> tuple[Array, Array]:
    """Thin a curve out for a drawing: of every stretch the lowest and the highest point stay."""
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    stretches = np.minimum(edges[:-1, None] + np.arange(np.diff(edges).max()), edges[1:, None] - 1)
    values, rows = y[stretches], np.arange(len(stretches))
    kept = np.unique([stretches[rows, values.argmin(axis=1)], stretches[rows, values.argmax(axis=1)]])
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


def columns_of(topic: str, signal: Signal) -> list[tuple[str, Array]]:
    """Names and values (N,) of a signal's axes: "command", or "command.x" of several."""
    several = len(signal.axes) > 1
    return [(f"{topic}.{axis}" if several else topic, signal.values[:, index]) for index, axis in enumerate(signal.axes)]


def draw(panels: Sequence[Panel], figure: Figure, title: str) -> list[Axes]:
    """Draw panels below each other into a figure of matplotlib; the axes, one a panel."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm, Normalize

    figure.set_size_inches(9.0, 1.0 + 3.2 * len(panels))
    figure.set_layout_engine("constrained")
    figure.suptitle(title)
    drawn = list(figure.subplots(len(panels), squeeze=False)[:, 0])
    for panel, axes in zip(panels, drawn, strict=True):
        norm: Normalize | None = None
        if panel.shades:
            linear = panel.shade_title.startswith("time") or panel.shades[0] == panel.shades[1]
            norm = (Normalize if linear else LogNorm)(*panel.shades)
        for index, line in enumerate(panel.lines):
            if line.shade is not None:
                points = np.column_stack([line.x, line.y])[:, None]
                segments = np.concatenate([points[:-1], points[1:]], axis=1)
                axes.add_collection(LineCollection(list(segments), array=line.shade[:-1], cmap=COLOR_MAP, norm=norm, linewidth=1.0))
                continue
            size = 3.0 if line.marker == "." else 6.0
            look = (
                {"marker": line.marker, "linestyle": "", "markersize": size, "fillstyle": "none" if line.marker == "o" else "full"}
                if line.dots
                else {"linewidth": 1.0}
            )
            axes.plot(line.x, line.y, color=COLORS[(index + 1) % len(COLORS)], label=line.name, **look)
        if norm:
            axes.autoscale_view()
            figure.colorbar(ScalarMappable(norm, COLOR_MAP), ax=axes, label=panel.shade_title)
        axes.set(xlabel=panel.x_title, ylabel=panel.y_title)
        axes.set(**{f"{axis}scale": "log" for axis in panel.logarithmic}, ylim=panel.y_range)
        if sum(line.shade is None for line in panel.lines) > 1:
            axes.legend(loc="best", frameon=False)
        axes.grid(alpha=0.3)
    return drawn


def _write_picture(panels: Sequence[Panel], path: Path, title: str, ending: str) -> None:
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    FigureCanvasAgg(figure)
    draw(panels, figure, title)
    with replacing(path) as file, rc_context({"svg.fonttype": "none"}):  # texts stay texts, which can be searched
        figure.savefig(file, format=ending, dpi=120)


def _write_page(panels: Sequence[Panel], path: Path, title: str) -> None:
    import plotly.graph_objects as go

    page = Page(title, "")
    for panel in panels:
        figure = go.Figure()
        for index, line in enumerate(panel.lines):
            colour = COLORS[(index + 1) % len(COLORS)]
            if line.shade is not None:
                look = {"mode": "markers", "marker": _shaded(panel, line.shade, index == 0)}
            elif line.dots:
                form = {"x": "x", "o": "circle-open"}.get(line.marker, "circle")
                look = {"mode": "markers", "marker": {"color": colour, "size": 4 if line.marker == "." else 8, "symbol": form}}
            else:
                look = {"line": {"color": colour, "width": 1.3}}
            figure.add_trace(go.Scattergl(x=line.x, y=line.y, name=line.name, **look))
        scales = {axis: "log" if axis in panel.logarithmic else "linear" for axis in "xy"}
        figure.update_xaxes(title_text=panel.x_title, type=scales["x"])
        figure.update_yaxes(title_text=panel.y_title, type=scales["y"], range=panel.y_range)
        page.figure(figure)
    page.write(path)


def _shaded(panel: Panel, shade: Array, first: bool) -> dict[str, Any]:
    """Markers of a page that are colored by their shade, with the scale beside the first curve; a frequency's is logarithmic."""
    assert panel.shades is not None
    linear = panel.shade_title.startswith("time") or panel.shades[0] == panel.shades[1]
    ends = np.array(panel.shades, dtype=float)
    ends = ends if linear else np.log10(ends)
    marks = np.linspace(ends[0], ends[1], 5)
    texts = [f"{mark if linear else 10**mark:.3g}" for mark in marks]
    bar = {"title": {"text": panel.shade_title}, "tickvals": marks, "ticktext": texts}
    values = shade if linear else np.log10(shade)
    look = {"color": values, "cmin": ends[0], "cmax": ends[1], "colorscale": COLOR_MAP.capitalize(), "size": 3, "showscale": first}
    return {**look, "colorbar": bar}
