"""Identification: models from records. `identify` is the one entry the command line, the node and scripts use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hyst_control import progress
from hyst_control.errors import InputError
from hyst_control.identify.dataset import Dataset, Fit

PRANDTL_FAMILIES = ("pi", "hapi", "rdpi", "hampi")
FAMILIES = (*PRANDTL_FAMILIES, "madelung", "mhl", "linear")


def identify(datasets: Sequence[Dataset], family: str, method: str = "joint", **options: Any) -> Fit:
    """Identify a model of `family`: from all records at once ("joint"), or in its paper's sequence ("paper").

    Raises `InputError` for an unknown family or method, and where the records cannot tell the model.
    """
    if family not in FAMILIES:
        raise InputError(f"model: {family!r} is not a model family: one of {', '.join(FAMILIES)} is due")
    if method not in ("joint", "paper"):
        raise InputError(f"method: {method!r} is not known: joint or paper is due")
    progress.step(f"identify {family} ({method}) from {sum(len(data.command) for data in datasets)} samples")
    if family in PRANDTL_FAMILIES:
        from hyst_control.identify import hammerstein, paper_hampi

        if method == "joint":
            return hammerstein.fit(datasets, family, hammerstein.Options(**options))
        if family in ("hapi", "hampi"):
            return paper_hampi.fit(datasets, family, hammerstein.Options(**options))
    if family == "mhl":
        from hyst_control.identify import mhl

        return mhl.fit(datasets, method, **options)
    if method == "paper":
        raise InputError(f"method: paper is a sequence for hapi, hampi and mhl, not for {family}: use joint")
    if family == "madelung":
        from hyst_control.identify import madelung

        return madelung.fit(datasets, **options)
    from hyst_control.identify import linear

    return linear.fit(datasets, **options)


__all__ = ["FAMILIES", "Dataset", "Fit", "identify"]
