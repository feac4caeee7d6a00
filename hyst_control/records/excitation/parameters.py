# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of all kinds of signals, declared once in `parameters.yaml`: what the reference generator and the documents say of them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from hyst_control.base.quantity import NUMBER, Quantity
from hyst_control.base.yaml_files import read_yaml

COMMON = ("lower", "upper", "slew_limit", "axis", "idle")  # Parameters that every kind takes


@cache
def declarations() -> dict[str, Any]:
    """Unit and meaning of every parameter: `common`, `signals`, and what differs in some `kinds`."""
    declared: dict[str, Any] = read_yaml(Path(__file__).with_suffix(".yaml"))
    return declared


def described(kind: str, name: str) -> Quantity:
    """Unit and meaning of a parameter of a kind of signal, without a default."""
    declared = declarations()
    unit, meaning = {**declared["common"], **declared["signals"], **declared["kinds"].get(kind, {})}[name]
    return Quantity(name, None, unit, meaning, kind=NUMBER)
