"""Pages from templates: whatever the texts hold, a browser shows them as they are."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jinja2 import UndefinedError

from hyst_control.reporting import html_page
from hyst_control.reporting.html_page import Page
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
        elif tag not in ("html", "head", "meta", "style", "script", "body", "table", "thead", "tbody", "tr"):
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
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(html_page, "get_plotlyjs", lambda: "")
        page.write(Path(folder) / "page.html")
        reader.feed((Path(folder) / "page.html").read_text(encoding="utf-8"))
    head, table = [("title", title), ("h1", title), ("p", summary), ("h2", heading), ("p", paragraph)], cells
    due = [*head, ("th", table[0]), ("th", table[1]), ("td", table[2]), ("td", table[3]), ("p", note)]
    assert [each for each in reader.found if each[0]] == due and not reader.unknown


def test_a_value_that_a_template_misses_is_an_error():
    with pytest.raises(UndefinedError, match="summary"):
        render("reporting/templates/page.html", title="t", plotly_script="", content=[])


def test_markdown_is_not_escaped():
    text = render("reporting/templates/tables.md", headers=["a"], tables={"<1 %": [["<0.1"]]})
    assert "### <1 %" in text and "| <0.1 |" in text
