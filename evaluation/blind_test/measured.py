"""Cases of measured plants whose model lost one element: each is diagnosed, scored, and shown on a page (`withheld_page`)."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from evaluation.blind_test.withheld_cases import PLANTS, Withheld, mirror_cases, stack_cases
from evaluation.blind_test.withheld_page import write_page
from evaluation.blind_test.withheld_scores import add, add_summary
from evaluation.reproduction import fsm_cubespec_records as mirror
from hyst_control.diagnose.report.document import sentence
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.errors import InputError
from hyst_control.files import read_json, write_json
from hyst_control.parallel import map_forked
from hyst_control.reporting.tables import Table

MODES = {"none": (), "middle": mirror.LEVELS[1:2], "all": mirror.LEVELS}
"""Levels (mV) whose model loses each of its modes."""


def run(
    out: str,
    page: str | None = None,
    modes: str = "all",
    note: Callable[[str], None] = print,
    plants: Sequence[str] | None = None,
    levels: Sequence[int] | None = None,
    so_far: bool = False,
) -> Table:
    """Diagnose every case."""
    # out: folder of the reports. A case whose report is there already is not diagnosed again: a run goes on where it stopped
    for given, known, what in ((plants, PLANTS, "--plants"), (levels, mirror.LEVELS, "--levels")):
        for value in given or ():
            if value not in known:
                raise InputError(f"{what} {value}: unknown, give some of {', '.join(map(str, known))}")
    folder = Path(out) / "measured"
    folder.mkdir(parents=True, exist_ok=True)
    table = Table("blind-test --measured")
    rows = []
    cases: list[Withheld] = []
    if plants is None or PLANTS[0] in plants:
        cases += stack_cases()
    if plants is None or PLANTS[1] in plants:
        cases += mirror_cases(MODES[modes], note, levels or mirror.LEVELS)
    missing: list[Withheld] = []
    if so_far:
        done = [kept_report(case, folder) is not None for case in cases]
        missing = [case for case, there in zip(cases, done, strict=True) if not there]
        cases = [case for case, there in zip(cases, done, strict=True) if there]
        if not cases:
            raise InputError(f"{folder}: no case has been diagnosed yet: call without --so-far")
    for case, report in zip(cases, map_forked(lambda i: report_on(cases[i], folder), len(cases)), strict=True):
        rows.append((case, report))
        add(table, case, report)
        note(f"{case.plant}, without {case.element}: {sentence(report)}")
    add_summary(table, rows)
    if page is not None:
        write_page(Path(page), rows, modes, plants or PLANTS, levels or mirror.LEVELS, missing)
    return table


def report_on(case: Withheld, folder: Path) -> dict[str, Any]:
    """Return the report on a case, from the folder where it is of this model and record, otherwise diagnosed now."""
    kept = kept_report(case, folder)
    if kept is not None:
        return kept
    begin = time.monotonic()
    report = {**diagnosed([case.record], case.model, warm_up=case.warm_up)[0], "case": case.digest()}
    write_json(path_of(case, folder), {**report, "seconds": time.monotonic() - begin})
    return report


def kept_report(case: Withheld, folder: Path) -> dict[str, Any] | None:
    """Return the report on a case from the folder; None where there is none, or one of another model or record."""
    path = path_of(case, folder)
    kept = read_json(path) if path.exists() else {}
    return kept if kept.get("case") == case.digest() else None


def path_of(case: Withheld, folder: Path) -> Path:
    """Return the file of the report on a case."""
    return folder / (re.sub(r"[^a-z0-9]+", "_", f"{case.plant} {case.element}".lower()).strip("_") + ".json")
