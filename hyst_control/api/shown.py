# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of every result: a summary in words, a table, drawings, and a look in notebooks."""

from __future__ import annotations

import html
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import INTEGER, NUMBER, Quantity
from hyst_control.reporting.signal_figures import Panel, draw, write_drawing
from hyst_control.reporting.tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Kind = TypeVar("Kind")
RATE = Quantity("rate", None, "Hz", "sample rate", above=0.0, kind=NUMBER)
SEED = Quantity("seed", None, "", "seed from which noise is drawn", lower=0, kind=INTEGER)


class Shown:
    """A result that people look at."""

    @abstractmethod
    def summary(self) -> str:
        """The result in a few lines."""

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary())}</pre>"


def drawn(panels: Sequence[Panel], title: str, path: str | Path | None) -> list[Axes]:
    """Draw panels for a script or a notebook, into a file as well where a path is given; the axes of matplotlib."""
    import matplotlib.pyplot

    if path is not None:
        write_drawing(panels, path, title)
    return draw(panels, matplotlib.pyplot.figure(), title)


def promoted(kind: type[Kind], found: Any, **more: Any) -> Kind:
    """A dataclass of the package as one of the front door, which adds methods, and the fields `more`, to it."""
    return kind(**{each.name: getattr(found, each.name) for each in fields(found)}, **more)


def step_of(rate: float | None, own: float | None = None) -> float:
    """Sample time (s) of a sample rate in Hz, or the model's own where none is given and there is one."""
    return own if rate is None and own else 1.0 / float(RATE.checked(rate))


def rows_of(name: str, values: ArrayLike) -> Array:
    """Samples by axes (N, A) of an array (N,) or (N, A)."""
    try:
        given = np.asarray(values)
        rows = np.asarray(given, dtype=None if given.dtype.kind == "c" else float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be numbers: convert what is none") from None
    if np.iscomplexobj(rows):
        raise InputError(f"{name}: must be real numbers, got complex ones: take their real part or their size")
    rows = rows[:, None] if rows.ndim == 1 else rows
    if rows.ndim != 2 or not rows.size:
        raise InputError(f"{name}: must be samples (N,) or samples by axes (N, A), got shape {np.shape(values)}")
    return rows


def rows_for(name: str, values: ArrayLike, axes: Sequence[str]) -> Array:
    """The same of what goes into a model: finite samples of each of its axes."""
    rows = rows_of(name, values)
    if rows.shape[1] != len(axes):
        raise InputError(
            f"{name}: has {rows.shape[1]} columns, the model {len(axes)} axes: give a column for each of {', '.join(axes)}"
        )
    if not np.isfinite(rows).all():
        raise InputError(f"{name}: row {int(np.argmin(np.isfinite(rows).all(axis=1)))} holds no finite number: replace or cut it")
    return rows


def table_frame(table: Table) -> Any:
    """A result table as a pandas DataFrame."""
    return needed("pandas").DataFrame([vars(row) for row in table.rows])


def needed(name: str) -> Any:
    """The package pandas or xarray, which is needed where tables go in or out."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise InputError(f"{name} is not installed: pip install {name}") from None
