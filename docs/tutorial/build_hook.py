"""Hook of the site's build: failing tutorial pages end it, the time of each is told, equations are made ready for a browser."""

from __future__ import annotations

import logging
import re
import time
from typing import Any

from latex2mathml.converter import convert

EQUATION = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)

_begun: dict[str, float] = {}


def on_startup(**_: Any) -> None:
    """Let failures of executed blocks reach the build's strict mode, which `--quiet` would hide from it."""
    for name in ("mkdocs.plugins.markdown_exec", "mkdocs.plugins.markdown-exec"):
        logging.getLogger(name).setLevel(logging.WARNING)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Begin to count; the blocks run while the page is rendered."""
    _begun[page.file.src_uri] = time.monotonic()
    return with_equations(markdown)


def with_equations(markdown: str) -> str:
    """Replace equations, LaTeX between lines of `$$`, by MathML: a browser draws it, and nothing is fetched."""
    return EQUATION.sub(lambda found: f"\n{convert(found[1].replace(chr(10), ' '), display='block')}\n", markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Tell the time."""
    name = page.file.src_uri
    if name.startswith("tutorial/"):
        print(f"{time.monotonic() - _begun[name]:6.1f} s  {name}")
    return html
