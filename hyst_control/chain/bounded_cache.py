# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Cache of results: a fit builds hundreds of chains that differ in one number, and most of their parts are the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np

KEPT = 512  # Results per function; when there are more, the one that was not asked for longest is dropped

PLAIN = frozenset({float, int, bool, str, type(None)})  # Types of what cannot be changed, and is compared and hashed as it is

Result = TypeVar("Result")


class _Call:
    """Arguments of a call, compared and hashed by their values."""

    __slots__ = ("arguments", "key")

    def __init__(self, arguments: tuple[object, ...]) -> None:
        self.arguments = arguments
        self.key = tuple(map(_key, arguments))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self.key == other.key


def remembered(work: Callable[..., Result]) -> Callable[..., Result]:
    """Keep the results of a function: for the same values it returns the same object, which must not be changed."""

    @lru_cache(KEPT)
    def result_of(call: _Call) -> Result:
        result = work(*call.arguments)
        call.arguments = ()  # the key is kept, and holds all that is compared
        return result

    @wraps(work)
    def recalled(*arguments: object) -> Result:
        return result_of(_Call(arguments))

    return recalled


def _key(value: object) -> object:
    if type(value) in PLAIN:
        return value
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, (list, tuple)):
        return tuple(map(_key, value))
    parts = getattr(value, "__dict__", None)
    if parts is not None and any(isinstance(part, np.ndarray) for part in parts.values()):
        return type(value), *(_key(part) for part in parts.values())
    return value
