"""Scores of the measured cases with an effect withheld."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from evaluation.blind_test.withheld_cases import NOTHING, Withheld
from hyst_control.reporting.tables import Table

TITLE = "Measured, an effect withheld"


def add(table: Table, case: Withheld, report: dict[str, Any]) -> None:
    """Add the figures of one case."""
    table.add(TITLE, case.plant, f"without {case.element}", "gap_rms", report["gap"]["unit"], report["gap"]["rms"])
    table.add(TITLE, case.plant, f"without {case.element}", "whole_model_rms", report["gap"]["unit"], case.floor)
    table.add(TITLE, case.plant, f"without {case.element}", "named", "", float(named_right(case, report)))
    table.add(TITLE, case.plant, f"without {case.element}", "shrink", "", best_shrink(report))
    table.add(TITLE, case.plant, f"without {case.element}", "unexplained", "", float(report["unexplained_share"] or 0.0))


def is_solved(case: Withheld, report: dict[str, Any]) -> bool:
    """Report whether a case has the right verdict: no gap of a whole model, else the withheld element first, and an explanation."""
    if case.element == NOTHING:
        return bool(report["verdict"] == "no_gap")
    return named_right(case, report) and report["verdict"] in ("effect", "parameters")


def named_right(case: Withheld, report: dict[str, Any]) -> bool:
    """Report whether the first name given is the withheld element, or one that the data cannot separate from it."""
    return bool(report["effects"]) and report["effects"][0]["name"] in case.right


def best_shrink(report: dict[str, Any]) -> float:
    """Largest reduction of the gap's energy above the noise by a named effect on held-out blocks, coefficients fitted."""
    return max((effect["shrink_reidentified"] or 0.0 for effect in report["effects"]), default=0.0)


def add_summary(table: Table, rows: Sequence[tuple[Withheld, dict[str, Any]]]) -> None:
    """Add the fraction of cases in which the withheld element was the first name, with their number."""
    from evaluation.blind_test.metric import wilson

    solved = sum(is_solved(case, report) for case, report in rows)
    table.add(TITLE, "all", "all cases", "solved", "", solved / max(len(rows), 1), n=len(rows), ci95=wilson(solved, len(rows)))
    scored = [(case, report) for case, report in rows if case.right]
    right = sum(named_right(case, report) for case, report in scored)
    table.add(
        TITLE,
        "all",
        "withheld elements",
        "named_first",
        "",
        right / max(len(scored), 1),
        n=len(scored),
        ci95=wilson(right, len(scored)),
    )
