"""Workers of a study in the process of the test: what they compute is asked, not that they are processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from hyst_control.base.parallel import Workers


@contextmanager
def one_thread(_: Workers) -> Iterator[tuple[Executor, Callable[[], int]]]:
    """In place of `Workers.open`."""
    with ThreadPoolExecutor(1) as pool:
        yield pool, lambda: 1


@contextmanager
def one_process() -> Iterator[None]:
    """Studies start no process meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Workers, "open", one_thread)
        yield
