"""What a long command is doing, on one line of the terminal: silent unless a command asked for it, and where there is no terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_bar: Any = None
_within = ""


@contextmanager
def shown(wanted: bool = True) -> Iterator[None]:
    """Show the steps on the standard error while the context lasts, when that is a terminal."""
    global _bar
    if not wanted or not sys.stderr.isatty():
        yield
        return
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no thread of its own: what is shown may be forked
    _bar = tqdm(bar_format="{elapsed} {desc}", leave=False, file=sys.stderr)
    try:
        yield
    finally:
        _bar.close()
        _bar = None


def step(text: str) -> None:
    """Say what comes next."""
    if _bar is not None:
        _bar.set_description_str(": ".join(filter(None, [_within, text])), refresh=False)
        _bar.update()
        _bar.refresh()


@contextmanager
def steps(total: int) -> Iterator[Callable[[str], None]]:
    """A `step` for work of so many parts, which are counted; the steps within a part are shown behind it: "3/8 identify HAMPI: read"."""
    global _within
    count = 0

    def part(text: str) -> None:
        global _within
        nonlocal count
        count += 1
        _within = f"{count}/{total} {text}"
        step("")

    try:
        yield part
    finally:
        _within = ""
