# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pages from templates: whatever the texts hold, a browser shows them as they are."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jinja2 import UndefinedError

from hyst_control.reporting.html_page import INK, Page, Palette
from hyst_control.reporting.provenance import Origin, provenance
from hyst_control.reporting.quantities import quantity
from hyst_control.reporting.templates import render

TEXTS = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=12).map(lambda text: f"a{text}&lt;<b>'\"")


class Reader(HTMLParser):
    """Texts of the elements that a page may hold, as a browser shows them."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []
        self.unknown: list[str] = []
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("title", "h1", "h2", "p", "th", "td"):
            self.found.append((tag, ""))
        elif tag not in ("html", "head", "meta", "style", "script", "body", "table", "thead", "tbody", "tr", "div"):
            self.unknown.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in ("title", "h1", "h2", "p", "th", "td"):
            self.found.append(("", ""))

    def handle_data(self, data: str) -> None:
        if self.found and self.found[-1][0]:
            tag, text = self.found[-1]
            self.found[-1] = (tag, text + data)


@settings(max_examples=30, deadline=None)
@given(st.lists(TEXTS, min_size=9, max_size=9))
def test_every_text_is_shown_as_it_is(texts):
    title, summary, heading, paragraph, note, *cells = texts
    page = Page(title, summary)
    page.section(heading, paragraph)
    page.table(cells[:2], [cells[2:]])
    page.note(note)
    reader = Reader()
    with TemporaryDirectory() as folder:
        page.write(Path(folder) / "page.html")
        reader.feed((Path(folder) / "page.html").read_text(encoding="utf-8"))
    head, table = [("title", title), ("h1", title), ("p", summary), ("h2", heading), ("p", paragraph)], cells
    due = [*head, ("th", table[0]), ("th", table[1]), ("td", table[2]), ("td", table[3]), ("p", note)]
    assert [each for each in reader.found if each[0]] == due and not reader.unknown


def test_a_value_that_a_template_misses_is_an_error():
    with pytest.raises(UndefinedError, match="summary"):
        render("reporting/templates/page.html", title="t", plotting_library="", origins=[], content=[])


def test_markdown_is_not_escaped():
    text = render("reporting/templates/tables.md", headers=["a"], tables={"<1 %": [["<0.1"]]})
    assert "### <1 %" in text and "| <0.1 |" in text


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A page with two figures, whose name holds the end of a script."""
    page = Page("figures", "Two figures.", [Origin("record", ("nowhere",), True)])
    figure = go.Figure(go.Scatter(x=np.arange(50.0), y=np.arange(50.0) ** 2, name="</script><b>"))
    figure.update_xaxes(title_text="time (s)")
    page.figure(figure)
    page.figure(go.Figure(go.Bar(x=["a", "b"], y=[1.0, 2.0])))
    path = tmp_path_factory.mktemp("drawn") / "page.html"
    page.write(path)
    return path


@pytest.mark.parametrize("width", [480, 1280])
def test_a_browser_draws_what_is_written(drawn, width, browser):
    seen = browser(drawn, width)
    assert seen.figures == 2 and not seen.complaints and not seen.overlaps and not seen.empty_axes
    assert not seen.too_wide and seen.toolbars == 0  # a toolbar comes with the pointer


def test_a_dark_page_has_a_dark_ground(drawn, browser):
    light, dark = (sum(map(int, re.findall(r"\d+", browser(drawn, 800, scheme).ground))) for scheme in ("light", "dark"))
    assert light > 700 and dark < 150


def test_the_browser_finds_faults(tmp_path, browser):
    """What the tests of pages rely on: texts over each other, axes without a curve and an error of a script are seen."""
    page = Page("faults", "")
    figure = go.Figure(go.Scatter(x=[0.0, 1.0], y=[0.0, 1.0], xaxis="x2", yaxis="y2"))
    figure.update_layout(xaxis={"domain": [0.0, 0.4]}, xaxis2={"domain": [0.6, 1.0]}, yaxis2={"anchor": "x2"})
    for text in ("one text", "another text"):
        figure.add_annotation(x=0.3, y=0.5, xref="paper", yref="paper", text=text, showarrow=False)
    page.figure(figure)
    path = tmp_path / "page.html"
    page.write(path)
    path.write_text(path.read_text().replace("</body>", "<script>nothing.at_all</script></body>"))
    seen = browser(path, 800)
    assert ["one text", "another text"] in seen.overlaps and seen.complaints


def test_a_subject_keeps_its_color():
    palette = Palette("reference")
    colors = [palette.color(name) for name in ("reference", "HAPI", "HAMPI", "HAPI")]
    assert colors[0] == INK and colors[1] == colors[3] and len(set(colors)) == 3


def test_links_are_relative_to_the_page(tmp_path):
    (tmp_path / "bags" / "one").mkdir(parents=True)
    (tmp_path / "pages").mkdir()
    rows = dict(
        origin.seen_from(tmp_path / "pages")
        for origin in provenance([("record", [tmp_path / "bags/one", "gone"])], [("seed", "3")])
    )
    assert rows["record"] == [(str(tmp_path / "bags/one"), "../bags/one"), ("gone", None)]
    assert dict(Origin("record", (str(tmp_path / "bags"),), True).seen_from(tmp_path)[1:][0]) == {"bags": "bags"}
    assert rows["seed"] == [("3", None)] and {"command", "made by", "date"} <= set(rows)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (27219.8, "V/s", "27.2 kV/s"),
        (2e-4, "s", "200 us"),
        (0.031, "", "3.1 %"),
        (999.96, "Hz", "1 kHz"),
        (-0.0123456, "um", "-0.0123 um"),
        (0.0, "s", "0 s"),
        (float("inf"), "V", "inf V"),
    ],
)
def test_quantities_have_prefixes(value, unit, text):
    assert quantity(value, unit) == text
