# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A real browser for tests of pages: Debian's Chromium, driven by Playwright; what it sees of a page comes back as plain data."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

PATIENCE = 240_000
"""Milliseconds that a page may take on a busy machine."""

ADDRESS_SPACE = 2**37
"""Bytes of address space, not of memory, that Chromium reserves at least."""

LOOK = """() => {
  const unfolded = element => !element.closest("details:not([open]) > :not(summary)");
  const shown = element => { const box = element.getBoundingClientRect(); return box.width > 0 && box.height > 0 && unfolded(element); };
  const meet = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1.5
    && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1.5;
  const overlaps = [];
  const texts = "h1, h2, p, table, figure.chart, svg[role=img]";
  const blocks = [...document.querySelectorAll(texts)].filter(shown);
  blocks.forEach((a, i) => blocks.slice(i + 1).forEach(b => {
    if (!a.contains(b) && !b.contains(a) && meet(a.getBoundingClientRect(), b.getBoundingClientRect()))
      overlaps.push([a.textContent.slice(0, 40), b.textContent.slice(0, 40)]);
  }));
  for (const drawing of document.querySelectorAll("figure.chart, svg[role=img]")) {
    const words = [...drawing.querySelectorAll("text")].filter(word => word.textContent.trim() && shown(word));
    words.forEach((a, i) => words.slice(i + 1).forEach(b => {
      const rotated = [a, b].some(word => /rotate\\((?!0)/.test(word.getAttribute("transform") || ""));
      if (!rotated && meet(a.getBoundingClientRect(), b.getBoundingClientRect())) overlaps.push([a.textContent, b.textContent]);
    }));
  }
  const empty = [...document.querySelectorAll("figure.chart")].filter(unfolded).flatMap((chart, number) => {
    const drawing = chart.querySelector(".js-plotly-plot");
    if (!drawing) return [`figure ${number}: not drawn`];
    const used = new Set(drawing._fullData.map(trace => trace.xaxis + trace.yaxis));
    const lines = drawing.querySelectorAll(".js-line, .point path, path.point, .hm image").length;
    const bare = Object.keys(drawing._fullLayout._plots).filter(name => !used.has(name));
    return [...(lines ? [] : [`figure ${number}: no line and no bar`]), ...bare.map(name => `figure ${number}: axes ${name}`)];
  });
  const bare = [...document.querySelectorAll("table")].filter(table => !table.querySelector("tbody td")).map(table =>
    table.textContent.trim().slice(0, 40));
  const wide = document.documentElement.scrollWidth > document.documentElement.clientWidth + 1;
  const bars = [...document.querySelectorAll(".modebar")].filter(bar => getComputedStyle(bar).opacity !== "0").length;
  return { figures: document.querySelectorAll("figure.chart .js-plotly-plot").length, overlaps, empty_axes: empty,
           empty_tables: bare, height: document.documentElement.scrollHeight, text: document.body.innerText,
           too_wide: wide, toolbars: bars, ground: getComputedStyle(document.body).backgroundColor };
}"""


DRAWN = "[...document.querySelectorAll('figure.chart')].every(chart => chart.querySelector('.main-svg'))"


@dataclass(frozen=True)
class Seen:
    """Findings of a browser that has loaded a page.

    figures: drawn ones. overlaps: pairs of texts or blocks that lie over each other. empty_axes: figures without a curve, axes without a
    trace. empty_tables: those without a row. height: px. text: that is seen. too_wide: whether the page has to be scrolled sideways.
    toolbars: of figures, shown without being pointed at. ground: color of the page's background. complaints: errors and warnings of its
    console.
    """

    figures: int
    overlaps: list[list[str]]
    empty_axes: list[str]
    empty_tables: list[str]
    height: int
    text: str
    too_wide: bool
    toolbars: int
    ground: str
    complaints: list[str]


def missing() -> str:
    """Reason why there is no browser here, "" where there is one."""
    if _chromium() is None:
        return "no chromium: apt-get install chromium"
    space = resource.getrlimit(resource.RLIMIT_AS)[0]
    if space != resource.RLIM_INFINITY and space < ADDRESS_SPACE:
        return f"chromium needs more address space than {space / 2**30:.0f} GiB: ulimit -v unlimited"
    return "" if find_spec("playwright") else "no playwright: pip install playwright"


@contextmanager
def chromium() -> Iterator[Any]:
    """A running browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=_chromium(), args=["--no-sandbox", "--disable-gpu"], timeout=PATIENCE)
        try:
            yield browser
        finally:
            browser.close()


def look_at(
    browser: Any, path: Path, width: int, scheme: str = "light", picture: Path | None = None, unfolded: bool = False
) -> Seen:
    """Open a page, wait until its figures are drawn, and look at it; picture: a screenshot to write; unfolded: with all its details."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.set_default_timeout(PATIENCE)
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda line: complaints.append(line.text) if line.type in ("error", "warning") else None)
    try:
        page.goto(path.as_uri())
        if page.query_selector("#library"):
            page.wait_for_selector("body[data-drawn]")
        if unfolded:
            page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
            page.wait_for_function(DRAWN)
        if picture is not None:
            page.screenshot(path=str(picture), full_page=True)
        return Seen(**page.evaluate(LOOK), complaints=complaints)
    finally:
        page.close()


def _chromium() -> str | None:
    return next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
