# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated mirror of the MHL experiments, and tracking on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from evaluation.reproduction.machine_runs import Machine
from hyst_control.base.arrays import Array
from hyst_control.control.tuning import Tuning

SAMPLE_TIME = 2e-4
"""s, of the loop and its records (paper §4.5)."""
RATING = (0.0, 100.0)
CENTRE, REACH = 1.0, 0.9
"""mrad; of 0 … 2 mrad the last twentieth at either end is left, where remanence keeps the mirror from its end."""
SEED = 626
MIRROR = Machine("fsm", "mhl_feedforward", RATING, SAMPLE_TIME, ("x", "y"), "mrad")


@dataclass(frozen=True)
class Part:
    """Rows of the tracking run that belong to one experiment, and those of them that are scored."""

    begin: int
    end: int
    scored: int

    def tracked(self, signals: Mapping[str, Array], axis: int = 0) -> tuple[Array, Array]:
        """Reference and measurement (N,) of the scored rows."""
        return signals["reference"][self.scored : self.end, axis], signals["measurement"][self.scored : self.end, axis]


def track(
    folder: Path,
    kind: str,
    reference: Annotated[Array, "N 2"],
    tuning: Tuning | None,
    settings: Mapping[str, Any],
    preview: int,
    plant: Mapping[str, Any] | None = None,
) -> dict[str, Array]:
    """Run one tracking experiment with a compensator of `joint.yaml` beside its folder, and with feedback if it is tuned."""
    feedback: dict[str, Any] = {"slew_limit": 1e6, "feedback": tuning is not None}
    if tuning is not None:
        feedback |= {"kp": tuning.kp, "ki": tuning.ki, "roll_off": float(tuning.roll_off)}
    feedforward = {"kind": kind, "model": str(folder.parent / "joint.yaml"), **settings}
    return MIRROR.track(folder, reference, feedforward, feedback, preview, {"seed": SEED + 4, **(plant or {})})
