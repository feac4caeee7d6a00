"""docs/reproduction.md from the results of `hyst reproduce hampi` and `hyst reproduce mhl`: targets met and missed, then every row."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hyst_control.errors import InputError
from hyst_control.files import write_text
from hyst_control.reporting.table_page import markdown
from hyst_control.reporting.tables import SCHEMA, Row, Table
from hyst_control.reporting.templates import render
from hyst_control.reproduction.hampi_published import FREQUENCIES, TABLE_5

SOURCES = ("reproduce hampi", "reproduce mhl")


@dataclass(frozen=True)
class Target:
    """One figure against its bound; `cause` says in plain words why it is missed where it is."""

    name: str
    value: float
    bound: float
    unit: str
    at_least: bool = False
    cause: str = ""

    @property
    def met(self) -> bool:
        """True when the figure keeps the bound; a figure that is none does not."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound


class Rows:
    """The rows of one result, looked up by what they say."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = rows

    def value(self, table: str, case: str, subject: str, quantity: str) -> float:
        """The one row's value. Raises `InputError` when the result has none: it is of another version."""
        found = [
            row.value for row in self.rows if (row.table, row.case, row.subject, row.quantity) == (table, case, subject, quantity)
        ]
        if len(found) != 1:
            raise InputError(f"results: {len(found)} rows for {table}, {case}, {subject}, {quantity}: run the experiment again")
        return found[0]

    def least(self, table: str, quantity: str) -> float:
        """The least of a quantity over the cases measured on the truth plant; not a number where one is not."""
        values = [
            row.value for row in self.rows if row.table == table and row.quantity == quantity and row.case.startswith("truth")
        ]
        return min(values) if values and not any(math.isnan(value) for value in values) else math.nan


def read_result(path: str | Path) -> Table:
    """The table of a result file. Raises `InputError` when it is none of this package."""
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error}): give a file written by hyst reproduce --json") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA or document.get("source") not in SOURCES:
        raise InputError(f"{path}: is no result of hyst reproduce hampi or mhl")
    return Table(document["source"], [_row(row) for row in document["rows"]], document["machine"], document.get("notes", []))


def _row(values: dict[str, Any]) -> Row:
    return Row(**{**values, "value": math.nan if values["value"] is None else values["value"]})


def hampi_targets(rows: Rows) -> list[Target]:
    """The targets of the HAMPI experiments."""
    found = []
    for frequency, (_, published) in TABLE_5["HAMPI"].items():
        ours, theirs = (rows.value("HAMPI Table 5", f"{frequency:g} Hz", f"{name}, joint", "nrmse") for name in ("HAMPI", "HAPI"))
        found.append(Target(f"4 um at {frequency:g} Hz, open loop: NRMSE with HAMPI", ours, published, "%"))
        found.append(Target(f"4 um at {frequency:g} Hz: HAPI's NRMSE over HAMPI's", theirs / ours, 1.0, "", True))
    for frequency in FREQUENCIES:
        values = {
            name: rows.value("HAMPI Table 4", f"140 V, {frequency:g} Hz", name, "nrmse") for name in ("HAPI", "RDPI", "HAMPI")
        }
        found.append(Target(f"140 V at {frequency:g} Hz: NRMSE of HAMPI", values["HAMPI"], 3.0, "%"))
        if frequency > 50.0:
            found.append(
                Target(
                    f"140 V at {frequency:g} Hz: the next best model's NRMSE over HAMPI's",
                    min(values["HAPI"], values["RDPI"]) / values["HAMPI"],
                    1.0,
                    "",
                    True,
                )
            )
    table = "HAMPI models: identified jointly and in the paper's sequence"
    for name in ("HAPI", "HAMPI"):
        for quantity, what in (("nrmse, rms over frequencies", "all frequencies of a height together"), ("nrmse", "every loop")):
            worst, where = min(
                (rows.value(table, row.case, f"{name}, paper's sequence", quantity) / row.value, row.case)
                for row in rows.rows
                if row.table == table and row.subject == f"{name}, joint" and row.quantity == quantity
            )
            found.append(
                Target(
                    f"held out, {what}: NRMSE of {name} by the paper's sequence over the joint one's, at worst ({where})",
                    worst,
                    1.0,
                    "",
                    True,
                    MEAN_OF_LOOPS,
                )
            )
    return found + margin_targets(rows, "HAMPI model: feedback tuned on it", "")


def mhl_targets(rows: Rows) -> list[Target]:
    """The targets of the MHL experiments."""
    found = []
    names = ("proposed composite", "whole inverse")
    follows = {
        "proposed composite": "as published it inverts neither the delay nor G(s), whose lag and gain at 100 Hz are its error here; "
        "the whole inverse does",
        "whole inverse": "what the identified model leaves of hysteresis and relaxation; the feedback, whose integral action is "
        "held back to keep its margins with the mode moved, hardly acts at 100 Hz",
    }
    for case, bound, lower in (("single", 0.22, 86.0), ("decreasing", 0.58, 60.0), ("multi", 0.58, 43.0)):
        for name in names:
            found.append(
                Target(f"{case}: NRMSE, {name}", rows.value("MHL Table 4", case, name, "nrmse"), bound, "%", cause=follows[name])
            )
            value = rows.value("MHL Table 4", case, f"{name} against the traditional one", "nrmse lower by")
            found.append(
                Target(f"{case}: NRMSE lower than the traditional composite's, {name}", value, lower, "%", True, follows[name])
            )
    held_back = (
        "without feedback the step stays more than 2 % off (its row): what the identified hysteresis leaves of so small a step "
        "falls to the feedback's integral action, held back to keep its margins with the mode moved"
    )
    for name in names:
        at = ("MHL Fig. 18", "100 Hz", name)
        found += [
            Target(
                f"closed loop: bandwidth, {name}",
                rows.value("MHL Fig. 18", "closed loop", name, "bandwidth"),
                1500.0,
                "Hz",
                True,
                held_back,
            ),
            Target(
                f"closed loop: settling time, {name}",
                rows.value("MHL Fig. 18", "step", name, "settling_time"),
                2.0,
                "ms",
                cause=held_back if name == "whole inverse" else follows[name],
            ),
            Target(f"100 Hz: gain away from 0 dB, {name}", abs(rows.value(*at, "gain")), 0.2, "dB", cause=follows[name]),
            Target(f"100 Hz: phase away from 0, {name}", abs(rows.value(*at, "lag")), 0.7, "deg", cause=follows[name]),
        ]
    return found + margin_targets(rows, "MHL robustness", "the model of records at 5 kHz does not show the mode that is moved")


def margin_targets(rows: Rows, table: str, cause: str) -> list[Target]:
    """Gain and phase margin of the tuned feedback on the truth plant, the worst over gain ±10 % and first mode ±20 %."""
    return [
        Target(
            "tuned feedback on the truth plant, ±10 % gain, ±20 % mode: gain margin",
            rows.least(table, "gain_margin"),
            6.0,
            "dB",
            True,
            cause,
        ),
        Target(
            "tuned feedback on the truth plant, ±10 % gain, ±20 % mode: phase margin",
            rows.least(table, "phase_margin"),
            45.0,
            "deg",
            True,
            cause,
        ),
    ]


MEAN_OF_LOOPS = (
    "the mean of the loops, not their shape (rows with the means removed are below): the plant's loops sink as they get faster, and by "
    "other amounts while the drive has not been higher before. HAPI's mean cannot change with the rate, HAMPI's changes alike at all "
    "heights; a fit settles it where most of its records are, and the paper's sequence happens to settle it among the faster loops. "
    "Weighing every loop of the identification by its own range does not change that"
)

TARGETS: dict[str, tuple[str, Callable[[Rows], list[Target]]]] = {
    "reproduce hampi": ("HAMPI: piezo actuator", hampi_targets),
    "reproduce mhl": ("MHL: fast steering mirror", mhl_targets),
}


def write_page(results: Sequence[str | Path], path: str | Path) -> None:
    """Write the page of results.

    Parameters
    ----------
    results
        Files of `hyst reproduce --json`, one of each experiment.
    path
        Markdown file to write.

    Raises
    ------
    InputError
        When a file is no such result, or the page cannot be written.
    """
    tables = [read_result(result) for result in results]
    files = [f"{table.source.split()[-1]}.json" for table in tables]
    text = render(
        "reproduction/templates/reproduction.md",
        files=files,
        commands=[f"`hyst {table.source} --json {file}`" for table, file in zip(tables, files, strict=True)],
        results=[_section(table) for table in tables],
    )
    write_text(path, text.rstrip() + "\n")


def _section(table: Table) -> dict[str, object]:
    """Values of the page's section on one experiment."""
    title, targets = TARGETS[table.source]
    return {"title": title, "targets": targets(Rows(table.rows)), "notes": table.notes, "tables": markdown(table)}
