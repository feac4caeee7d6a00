"""Hook of the site's build: a tutorial page whose commands fail ends the build, and the time that each page takes is told."""

from __future__ import annotations

import logging
import time
from typing import Any

_begun: dict[str, float] = {}


def on_startup(**_: Any) -> None:
    """Let failures of executed blocks reach the build's strict mode, which `--quiet` would hide from it."""
    for name in ("mkdocs.plugins.markdown_exec", "mkdocs.plugins.markdown-exec"):
        logging.getLogger(name).setLevel(logging.WARNING)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Begin to count; the blocks run while the page is rendered."""
    _begun[page.file.src_uri] = time.monotonic()
    return markdown


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Tell the time."""
    name = page.file.src_uri
    if name.startswith("tutorial/"):
        print(f"{time.monotonic() - _begun[name]:6.1f} s  {name}")
    return html
