"""A target: one figure of a result against its bound; and the rows of a result, looked up by what they say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hyst_control.base.errors import InputError
from hyst_control.reporting.tables import Row

PAPER, OURS = "paper", "ours"
"""Origin of a bound: a figure or a statement of the paper, or our own choice."""


@dataclass(frozen=True)
class Target:
    """One figure against its bound.

    claim: what of the paper it belongs to; cause: in plain words, why it is missed; origin: of the bound, `PAPER` or `OURS`.
    """

    name: str
    value: float
    bound: float
    unit: str
    at_least: bool = False
    cause: str = ""
    claim: str = ""
    origin: str = PAPER

    @property
    def met(self) -> bool:
        """True when the figure keeps the bound; a figure that is none does not."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound


class TargetList:
    """Targets of one experiment, in the order in which they are added."""

    def __init__(self) -> None:
        self.found: list[Target] = []

    def add(
        self,
        claim: str,
        name: str,
        value: float,
        bound: float,
        unit: str = "",
        at_least: bool = False,
        cause: str = "",
        origin: str = PAPER,
    ) -> None:
        """Add a target, whose name begins with its claim."""
        self.found.append(Target(f"{claim}: {name}", value, bound, unit, at_least, cause, claim, origin))


class Rows:
    """The rows of one result, looked up by what they say."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = rows

    def value(self, table: str, case: str, subject: str, quantity: str) -> float:
        """Look up the value of one row."""
        found = [
            row.value for row in self.rows if (row.table, row.case, row.subject, row.quantity) == (table, case, subject, quantity)
        ]
        if len(found) != 1:
            raise InputError(f"results: {len(found)} rows for {table}, {case}, {subject}, {quantity}: run the experiment again")
        return found[0]

    def least(self, table: str, quantity: str) -> float:
        """Look up the least value of a quantity over the cases measured on the reference simulation."""
        values = [
            row.value for row in self.rows if row.table == table and row.quantity == quantity and row.case.startswith("truth")
        ]
        return min(values) if values and not any(math.isnan(value) for value in values) else math.nan


def margin_targets(rows: Rows, table: str, cause: str) -> list[Target]:
    """List gain and phase margin of the tuned feedback on the reference simulation, the worst over gain ±10 % and first mode ±20 %."""
    where = "tuned feedback on the truth plant, ±10 % gain, ±20 % mode"
    return [
        Target(f"{where}: gain margin", rows.least(table, "gain_margin"), 6.0, "dB", True, cause, origin=OURS),
        Target(f"{where}: phase margin", rows.least(table, "phase_margin"), 45.0, "deg", True, cause, origin=OURS),
    ]
