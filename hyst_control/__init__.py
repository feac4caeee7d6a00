# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""hyst_control: identification, control and gap diagnosis of piezo stages and fast steering mirrors.

`import hyst_control as hc` gives the names of `__all__`, each loaded when it is first used; docs/api.md has an example of each.
"""

import os
import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

# The matrices here are small: BLAS threads only spin against each other and against the nodes of a running loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hyst_control.base import numba_cache

numba_cache.prepare()

if TYPE_CHECKING:
    from hyst_control.api.gap import Gap, diagnose
    from hyst_control.api.model import Inverse, Model, Score, identify, load_model
    from hyst_control.api.record import Record, excitation, from_arrays, from_pandas, from_xarray, read_bag, read_csv, read_mat
    from hyst_control.api.tuning import Tuning, tune
    from hyst_control.base.errors import InputError

_HOMES = {
    "base.errors": ("InputError",),
    "api.record": ("Record", "excitation", "from_arrays", "from_pandas", "from_xarray", "read_bag", "read_csv", "read_mat"),
    "api.model": ("Inverse", "Model", "Score", "identify", "load_model"),
    "api.tuning": ("Tuning", "tune"),
    "api.gap": ("Gap", "diagnose"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Gap",
    "InputError",
    "Inverse",
    "Model",
    "Record",
    "Score",
    "Tuning",
    "diagnose",
    "excitation",
    "from_arrays",
    "from_pandas",
    "from_xarray",
    "identify",
    "load_model",
    "read_bag",
    "read_csv",
    "read_mat",
    "tune",
]


def _public(name: str) -> Any:
    return getattr(import_module(f"hyst_control.{_HOME[name]}"), name)


class _Callable(ModuleType):
    """A package that has the name of a public function: called, it is that function."""

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        return _public(self.__name__.rpartition(".")[2])(*arguments, **keywords)


class _Front(ModuleType):
    """This module, whose packages `identify` and `diagnose` are set as attributes of the functions' names when they are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _HOME and isinstance(value, ModuleType):
            value.__class__ = _Callable
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return list(__all__)


sys.modules[__name__].__class__ = _Front


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return _public(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
