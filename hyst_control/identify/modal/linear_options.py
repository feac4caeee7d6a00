# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Options of the linear family."""

from __future__ import annotations

from dataclasses import dataclass

from hyst_control.identify.families.options import INTEGER, NUMBER, TRUTH, Options, option
from hyst_control.identify.families.shared_options import nuisance_option


@dataclass(frozen=True)
class LinearOptions(Options):
    """Options of a linear fit."""

    order: int | None = option(None, INTEGER, "number of states, where it is not to be chosen on held-out data", lower=1)
    coupled: bool | None = option(
        None,
        TRUTH,
        "whether axes drive each other (a state_space, the default for several axes) or not (a transfer_function per axis)",
    )
    delay: float | str = option(
        "estimate", NUMBER, "delay, where it is not to be estimated", unit="s", lower=0.0, choices=("estimate",)
    )
    direct: bool = option(True, TRUTH, "allow a direct path D besides the states")
    iterations: int = option(60, INTEGER, "most steps of the refinement", lower=0)
    nuisance: str = nuisance_option("linear")
