"""Results that are kept: a fit builds hundreds of chains that differ in one number, and most of their parts are the same."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, TypeVar

import numpy as np

KEPT = 512
"""Results per function; when there are more, all are forgotten."""

Result = TypeVar("Result")


def remembered(work: Callable[..., Result]) -> Callable[..., Result]:
    """The function, whose result for the same values is the same object: it must not be changed.

    Arguments, by position: arrays, dataclasses of arrays, lists, and what can be a dictionary's key.
    """
    known: dict[Hashable, Result] = {}

    @wraps(work)
    def recalled(*arguments: Any) -> Result:
        key = tuple(map(_key, arguments))
        found = known.get(key)
        if found is None:
            found = work(*arguments)
            if len(known) >= KEPT:
                known.clear()
            known[key] = found
        return found

    return recalled


def _key(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, (list, tuple)):
        return tuple(map(_key, value))
    parts = getattr(value, "__dict__", None)
    if parts is not None and any(isinstance(part, np.ndarray) for part in parts.values()):
        return type(value), *(_key(part) for part in parts.values())
    key: Hashable = value
    return key
