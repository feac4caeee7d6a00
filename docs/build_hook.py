# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hook of the site's build: adds reference pages and notebooks, prints the time of each page that runs, converts equations to MathML.

A tutorial page or notebook that fails ends the build.
"""

from __future__ import annotations

import logging
import re
import sys
import time
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

EQUATION = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)

_begun: dict[str, float] = {}
_reference: dict[str, str] = {}


def on_startup(**_: Any) -> None:
    """Let failures of executed blocks reach strict mode in spite of `--quiet`."""
    for name in ("mkdocs.plugins.markdown_exec", "mkdocs.plugins.markdown-exec"):
        logging.getLogger(name).setLevel(logging.WARNING)


def on_config(config: Any, **_: Any) -> Any:
    """Write the reference pages, and replace each folder of them in the navigation by its pages."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from docs.reference.pages import pages

    _reference.update(pages())
    config.nav = _expanded(config.nav)
    return config


def _expanded(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    def pages_of(value: Any) -> Any:
        if isinstance(value, list):
            return _expanded(value)
        return [path for path in _reference if path.startswith(value)] if value.endswith("/") else value

    return [{title: pages_of(value) for title, value in entry.items()} for entry in entries]


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add the reference pages, and the executed notebooks, to the site."""
    from mkdocs.structure.files import File

    from docs import notebook_pages

    for path, text in _reference.items():
        files.append(File.generated(config, path, content=text))
    for name in notebook_pages.NAMES:
        begin = time.monotonic()
        files.append(File.generated(config, f"notebooks/{name}.md", content=notebook_pages.page(name)))
        print(f"{time.monotonic() - begin:6.1f} s  notebooks/{name}.ipynb")
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Start the clock of a page, whose blocks run while it is rendered."""
    _begun[page.file.src_uri] = time.monotonic()
    return with_equations(markdown)


def with_equations(markdown: str) -> str:
    """Replace LaTeX equations between lines of `$$` by MathML, which a browser draws without any library."""
    return EQUATION.sub(lambda found: f"\n{convert(found[1].replace(chr(10), ' '), display='block')}\n", markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Print the time of a tutorial page."""
    name = page.file.src_uri
    if name.startswith("tutorial/"):
        print(f"{time.monotonic() - _begun[name]:6.1f} s  {name}")
    return html
