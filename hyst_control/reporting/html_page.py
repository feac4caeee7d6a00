"""One self-contained HTML page: text, tables and zoomable figures, no network needed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from hyst_control.files import write_text

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2430; background: #fbfbf9; margin: 2rem auto; max-width: 1080px;
  padding: 0 1rem; }
h1 { font-size: 1.7rem; margin-bottom: 0.2rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
table { border-collapse: collapse; margin: 0.8rem 0; }
th, td { padding: 0.25rem 0.9rem; border-bottom: 1px solid #d9dcd6; text-align: right; }
th:first-child, td:first-child { text-align: left; } th { font-weight: 600; } .note { color: #596273; font-size: 0.92rem; }
"""
COLOURS = ("#1c2430", "#c2542d", "#2a6f97", "#5b8e3e", "#8a5aa8", "#b08a1e")
LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "colorway": COLOURS,
    "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "legend": {"orientation": "h", "y": 0.0, "yref": "container", "yanchor": "bottom"},
}


class Page:
    """Collects sections, then writes the page."""

    def __init__(self, title: str, summary: str) -> None:
        self.title = title
        self._parts = [f"<h1>{escape(title)}</h1>", f"<p>{escape(summary)}</p>"]

    def section(self, heading: str, text: str = "") -> None:
        """A heading, and a paragraph under it."""
        self._parts.append(f"<h2>{escape(heading)}</h2>" + (f"<p class='note'>{escape(text)}</p>" if text else ""))

    def table(self, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table of ready texts."""
        head = "".join(f"<th>{escape(header)}</th>" for header in headers)
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        self._parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")

    def figure(self, figure: go.Figure, height: int = 420) -> None:
        """A zoomable figure."""
        figure.update_layout(**LAYOUT, height=height)
        self._parts.append(
            figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "responsive": True})
        )

    def note(self, text: str) -> None:
        """A small paragraph."""
        self._parts.append(f"<p class='note'>{escape(text)}</p>")

    def picture(self, svg: str) -> None:
        """A drawing; its texts must be escaped already."""
        self._parts.append(svg)

    def write(self, path: Path) -> None:
        """Write the page with the plotting library inside it; a reader never meets half of it. Raises `InputError`."""
        write_text(
            path,
            "<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
            f"content='width=device-width, initial-scale=1'><title>{escape(self.title)}</title><style>{STYLE}</style>"
            f"<script>{get_plotlyjs()}</script></head><body>{''.join(self._parts)}</body></html>\n",
        )
