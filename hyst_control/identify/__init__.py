"""Identification: models from records. `identify` is the one entry the command line, the node and scripts use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hyst_control.errors import InputError
from hyst_control.identify.dataset import Dataset, Fit

PRANDTL_FAMILIES = ("pi", "hapi", "rdpi", "hampi")


def identify(datasets: Sequence[Dataset], family: str, method: str = "joint", **options: Any) -> Fit:
    """Identify a model of `family`: from all records at once ("joint"), or in its paper's sequence ("paper").

    Raises `InputError` for an unknown family, and where the records cannot tell the model.
    """
    if method not in ("joint", "paper"):
        raise InputError(f"method: {method!r} is not known: joint or paper is due")
    if family in PRANDTL_FAMILIES:
        from hyst_control.identify import hammerstein, paper_hampi

        if method == "paper":
            if family not in ("hapi", "hampi"):
                raise InputError(f"method: paper is a sequence for hapi, hampi and mhl, not for {family}: use joint")
            return paper_hampi.fit(datasets, family, hammerstein.Options(**options))
        return hammerstein.fit(datasets, family, hammerstein.Options(**options))
    raise InputError(f"model: {family!r} is not a model family: one of {', '.join(PRANDTL_FAMILIES)} is due")


__all__ = ["Dataset", "Fit", "identify"]
