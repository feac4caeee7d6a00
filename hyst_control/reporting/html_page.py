"""One self-contained HTML page: text, tables and zoomable figures, no network needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from hyst_control.files import write_text
from hyst_control.reporting.templates import render, render_markup

COLOURS = ("#1c2430", "#c2542d", "#2a6f97", "#5b8e3e", "#8a5aa8", "#b08a1e")
LAYOUT: Mapping[str, object] = {
    "template": "plotly_white",
    "colorway": COLOURS,
    "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "legend": {"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"},
}


class Page:
    """Sections of a page, collected in the order of the calls, then written.

    Parameters
    ----------
    title
        Heading of the page, and its name in the browser.
    summary
        First paragraph.
    """

    def __init__(self, title: str, summary: str) -> None:
        self.title = title
        self.summary = summary
        self._parts: list[Markup] = []

    def section(self, heading: str, text: str = "") -> None:
        """Begin a section: a heading, and a paragraph under it."""
        self._parts.append(render_markup("reporting/templates/section.html", heading=heading, text=text))

    def table(self, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table of ready texts, one row as long as the headers."""
        self._parts.append(render_markup("reporting/templates/table.html", headers=headers, rows=rows))

    def figure(self, figure: go.Figure, height: int = 420) -> None:
        """Add a zoomable figure of a height in pixels."""
        figure.update_layout(**LAYOUT, height=height)
        config = {"displaylogo": False, "responsive": True}
        self._parts.append(Markup(figure.to_html(full_html=False, include_plotlyjs=False, config=config)))

    def note(self, text: str) -> None:
        """Add a small paragraph."""
        self._parts.append(render_markup("reporting/templates/note.html", text=text))

    def picture(self, drawing: Markup) -> None:
        """Add a drawing, of `templates.render_markup`."""
        self._parts.append(drawing)

    def write(self, path: Path) -> None:
        """Write the page with the plotting library inside it; a reader never meets half of it.

        Parameters
        ----------
        path
            File to write, in a folder that exists.

        Raises
        ------
        InputError
            When the file cannot be written.
        """
        script = Markup(get_plotlyjs())
        values = {"title": self.title, "summary": self.summary, "plotly_script": script, "parts": self._parts}
        write_text(path, render("reporting/templates/page.html", **values))
