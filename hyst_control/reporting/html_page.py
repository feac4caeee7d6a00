"""One self-contained HTML page: text, tables and zoomable figures, no network needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from hyst_control.files import write_text
from hyst_control.reporting.templates import render

COLORS = ("#1c2430", "#c2542d", "#2a6f97", "#5b8e3e", "#8a5aa8", "#b08a1e")
LAYOUT: Mapping[str, object] = {
    "template": "plotly_white",
    "colorway": COLORS,
    "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "legend": {"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"},
}


def figure_markup(figure: go.Figure, height: int = 420) -> Markup:
    """Convert a zoomable figure to markup for a template; the page must hold the plotting library.

    Parameters
    ----------
    figure
        The figure.
    height
        Height, pixels.

    Returns
    -------
    Markup
        The markup.
    """
    figure.update_layout(**LAYOUT, height=height)
    return Markup(figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "responsive": True}))


def write_page(path: Path, template: str, title: str, summary: str, **values: object) -> None:
    """Write a page from a template that extends ``reporting/templates/page.html``, with the plotting library inside it.

    Parameters
    ----------
    path
        File to write, in an existing folder; it is replaced as a whole.
    template
        Path of the template within the package.
    title
        Heading of the page, and its name in the browser.
    summary
        First paragraph.
    **values
        Further values that the template names.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    write_text(path, render(template, title=title, summary=summary, plotly_script=Markup(get_plotlyjs()), **values))


class Page:
    """A page in the common template: sections, tables and figures in the order of the calls.

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
        self._content: list[dict[str, object]] = []

    def section(self, heading: str, text: str = "") -> None:
        """Begin a section: a heading, and a paragraph under it.

        Parameters
        ----------
        heading
            The heading.
        text
            The paragraph.
        """
        self._content.append({"kind": "section", "heading": heading, "text": text})

    def table(self, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table of texts.

        Parameters
        ----------
        headers
            Headers of the columns.
        rows
            Rows, each as long as the headers.
        """
        self._content.append({"kind": "table", "headers": headers, "rows": rows})

    def figure(self, figure: go.Figure, height: int = 420) -> None:
        """Add a zoomable figure.

        Parameters
        ----------
        figure
            The figure.
        height
            Height, pixels.
        """
        self._content.append({"kind": "figure", "drawing": figure_markup(figure, height)})

    def note(self, text: str) -> None:
        """Add a small paragraph.

        Parameters
        ----------
        text
            The paragraph.
        """
        self._content.append({"kind": "note", "text": text})

    def write(self, path: Path) -> None:
        """Write the page; see `write_page`.

        Parameters
        ----------
        path
            File to write.
        """
        write_page(path, "reporting/templates/page.html", self.title, self.summary, content=self._content)
