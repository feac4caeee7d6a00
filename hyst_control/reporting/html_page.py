# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML page: a verdict first, where it comes from, then figures and tables that it draws without a network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from markupsafe import Markup

from hyst_control.base.files import write_text
from hyst_control.base.parallel import in_thread
from hyst_control.reporting.provenance import Origin
from hyst_control.reporting.templates import render

INK = "#1c2430"
"""Color of what was measured or asked for; the page draws it light on a dark background."""
COLORS = (INK, "#c2542d", "#2a6f97", "#5b8e3e", "#8a5aa8", "#b08a1e")
BAND = "rgba(120,130,145,0.28)"  # Color of a band of uncertainty
LAYOUT: Mapping[str, object] = {
    "colorway": COLORS,
    "margin": {"l": 70, "r": 20, "t": 48, "b": 50},
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "legend": {"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"},
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#8a93a1", "activecolor": "#596273"},
}
GRID = {"gridcolor": "rgba(130,140,155,0.3)", "zerolinecolor": "rgba(130,140,155,0.6)", "automargin": True}


class Palette:
    """Colors of the subjects of a page: a subject has the same color in every figure."""

    def __init__(self, *subjects: str) -> None:
        self._colors: dict[str, str] = {}
        for subject in subjects:
            self.color(subject)

    def color(self, subject: str) -> str:
        """Color of a subject; a new subject gets the next one."""
        return self._colors.setdefault(subject, COLORS[len(self._colors) % len(COLORS)])


class Drawn(Protocol):
    """A figure of this package or of Plotly."""

    def to_plotly_json(self) -> dict[str, Any]:
        """Traces and layout."""


def figure_markup(figure: Drawn, height: int = 420, min_width: int = 0) -> Markup:
    """Convert a zoomable figure to markup for a template; the page draws it."""
    found: dict[str, Any] = json.loads(figure.to_json()) if hasattr(figure, "to_json") else figure.to_plotly_json()
    layout = {"xaxis": {}, "yaxis": {}, **found["layout"], **LAYOUT, "height": height}
    layout["title"] = {**layout.get("title", {}), "x": 0.0}
    layout.pop("template", None)
    for name, axis in layout.items():
        if name.startswith(("xaxis", "yaxis")):
            axis.update(GRID)
        if name.startswith("xaxis"):
            axis["ticklabelstandoff"] = 7  # the label below the corner does not touch the one beside it
    data = json.dumps({"data": found["data"], "layout": layout}, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return Markup(  # JSON within a script element needs no escape but that of its end
        f"<div class='wide'><figure class='chart' style='height:{height}px;min-width:{min_width}px'>"
        f"<script type='application/json'>{data}</script></figure></div>"
    )


@cache
def library() -> Callable[[], str]:
    """The plotting library, compressed (gzip, base64: two megabytes instead of five) beside what is done until it is called for."""
    return in_thread(_compressed_library)


def _compressed_library() -> str:
    package = find_spec("plotly")  # whose import is not needed for a file of it
    assert package is not None and package.origin is not None, "plotly is a dependency"
    script = Path(package.origin).parent / "package_data" / "plotly.min.js"
    return base64.b64encode(gzip.compress(script.read_bytes(), 4, mtime=0)).decode()


def write_page(
    path: Path, template: str, title: str, summary: str, *, origins: Sequence[Origin] = (), figures: bool = True, **values: object
) -> None:
    """Write a page from a template that extends ``reporting/templates/page.html``, with the plotting library inside it."""
    plotting = library()() if figures else ""
    rows = [origin.seen_from(path.parent) for origin in origins]
    write_text(path, render(template, title=title, summary=summary, origins=rows, plotting_library=plotting, **values))


class Page:
    """A page in the common template: sections, tables and figures in the order of the calls."""

    def __init__(self, title: str, summary: str, origins: Sequence[Origin] = ()) -> None:
        self.title = title
        self.summary = summary
        self.origins = origins
        self._content: list[dict[str, object]] = []

    def section(self, heading: str, text: str = "") -> None:
        """Begin a section: a heading, and a paragraph under it."""
        self._content.append({"kind": "section", "heading": heading, "text": text})

    def table(self, headers: Sequence[str], rows: Sequence[Sequence[str]], groups: Sequence[tuple[str, int]] = ()) -> None:
        """Add a table of texts; groups: a heading over so many columns each."""
        self._content.append({"kind": "table", "headers": headers, "rows": rows, "groups": groups})

    def figure(self, figure: Drawn, height: int = 420, min_width: int = 0) -> None:
        """Add a zoomable figure."""
        self._content.append({"kind": "figure", "drawing": figure_markup(figure, height, min_width)})

    def note(self, text: str) -> None:
        """Add a small paragraph."""
        self._content.append({"kind": "note", "text": text})

    def write(self, path: Path) -> None:
        """Write the page; see `write_page`."""
        drawn = any(part["kind"] == "figure" for part in self._content)
        template = "reporting/templates/page.html"
        write_page(path, template, self.title, self.summary, origins=self.origins, figures=drawn, content=self._content)
