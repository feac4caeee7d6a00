# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of docs/results.md from the result files in docs/data: `python docs/make_results.py`, from the repository's root.

Prints the tables, which the page contains verbatim (`test/test_results.py`), and draws `docs/figures/results_*.svg`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from evaluation.reproduction.page import TARGETS, read_result
from evaluation.reproduction.targets import PAPER, Rows
from hyst_control.base.files import read_json
from hyst_control.reporting.tables import Row

DOCS = Path(__file__).resolve().parent
DATA = DOCS / "data"
PAPERS = {"hampi": "HAMPI: piezo actuator", "mhl": "MHL: fast steering mirror"}
FREQUENCIES = ("10 Hz", "50 Hz", "100 Hz", "150 Hz")
LEVELS = ("100 mV", "200 mV", "300 mV")
REFERENCES = {"single": "one sine", "decreasing": "decreasing amplitude", "multi": "several sines"}
CONTROLLERS = {
    "static inverse": "traditional composite, PI without roll-off",
    "published composite": "proposed composite, N as published, PI without roll-off",
    "composite with zero-phase N": "proposed composite, N without phase",
    "whole inverse": "whole inverse",
}
MIRROR = {
    "linear, one model per level": ("Linear model per level, realization 6", "state space"),
    "linear, one model": ("One model for all levels, realization 6", "linear"),
    "softening modes, one model": (
        "One model for all levels, realization 6",
        "and force q|q|^0.5 + q|q|^1, stop operators of 30 mV, products q q",
    ),
}
OSCILLATORS = {"`bouc_wen`": "Bouc-Wen oscillator, gray box", "`duhem_oscillator`": "Duhem oscillator, generic"}
DIAGNOSIS = {
    "reference simulations of the papers: effect named first": "top-1, single effects on published plants, rich record, gap >= 3 sigma",
    "no gap: false alarm": "false alarm on records without a gap",
    "effect outside the catalogue: `unknown`": "open set: called unknown",
    "known effect: `unknown`": "single effects called unknown",
    "two effects: exactly both named": "pairs: exactly both",
    "two effects: at least one named": "pairs: at least one",
    "true parameter in its 90 % interval": "true parameter within its 90 % interval",
    "foreign physics, no baseline record": "`third` and Bouc-Wen stage, model identified, no clean record: top-1 at >= 3 x its own error",
    "injected 3 ×, no baseline record": "injected, no clean record: top-1 at 3 x",
    "injected 3 ×, baseline of another command": "injected, clean record of another command: top-1 at 3 x",
    "injected 3 ×, baseline of the same command": "injected, clean record of the same command: top-1 at 3 x",
}


def rows_of(name: str) -> list[Row]:
    """Rows of a result file in docs/data."""
    return [
        Row(**{**row, "value": math.nan if row["value"] is None else row["value"]})
        for row in read_json(DATA / f"{name}.json")["rows"]
    ]


def cases_of(name: str) -> list[dict[str, str]]:
    """Rows of a table of cases in docs/data."""
    with (DATA / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def tables() -> dict[str, str]:
    """Every table of the page as Markdown."""
    return {
        "targets": _targets(),
        "hampi": _hampi(),
        "mhl": _mhl(),
        "diagnosis": _diagnosis(),
        "withheld": _withheld(),
        "mirror": _mirror(),
        "oscillator": _oscillator(),
    }


def _targets() -> str:
    rows = []
    for name, title in PAPERS.items():
        table = read_result(DATA / f"{name}.json")
        found = TARGETS[table.source][1](Rows(table.rows))
        of_paper = [target for target in found if target.origin == PAPER]
        others = [target for target in found if target.origin != PAPER]
        rows.append([title, *(f"{sum(target.met for target in some)} of {len(some)}" for some in (of_paper, others))])
    return _table(["experiment", "published bounds met", "our own bounds met"], rows)


def _hampi() -> str:
    """NRMSE of tracking, beside the published one."""
    found = _lookup("hampi", "HAMPI Table 5")
    return _table(
        ["NRMSE, % (published)", *FREQUENCIES],
        [
            [name, *(_beside(found[frequency, f"{name}, paper", "nrmse"]) for frequency in FREQUENCIES)]
            for name in ("HAPI", "HAMPI")
        ],
    )


def _mhl() -> str:
    found = _lookup("mhl", "MHL Table 4")
    rows = [
        [
            title,
            *(
                _beside(found[reference, subject, "nrmse"], published=title in ("static inverse", "published composite"))
                for reference in REFERENCES
            ),
        ]
        for title, subject in CONTROLLERS.items()
    ]
    return _table(["NRMSE, % (published)", *REFERENCES.values()], rows)


def _diagnosis() -> str:
    found = {row.case: row for row in rows_of("blind_test")}
    rows = []
    for title, case in DIAGNOSIS.items():
        row = found[case]
        assert row.published is not None and row.ci95 is not None
        interval = f"{row.ci95[0]:.2f} … {row.ci95[1]:.2f}"
        rows.append(
            [
                title,
                f"{row.value:.2f}",
                interval,
                f"{row.n}",
                f"{'≤' if is_upper(row) else '≥'} {row.published:g}",
                "yes" if is_met(row) else "no",
            ]
        )
    return _table(["share", "measured", "95 % interval", "cases", "target", "met"], rows)


def is_upper(row: Row) -> bool:
    """Whether the target of a row of the blind test is an upper bound: of errors, and of the time."""
    return row.unit == "s" or (row.published or 0.0) <= 0.5


def is_met(row: Row) -> bool:
    """Whether a row of the blind test reaches its target."""
    target = row.published or 0.0
    return row.value <= target if is_upper(row) else row.value >= target


def _withheld() -> str:
    cases = cases_of("blind_test_measured")
    rows = []
    for plant in ("stack", "mirror"):
        mine = [case for case in cases if case["plant"].startswith(plant)]
        whole = [case for case in mine if case["withheld"] == "nothing"]
        lost = [case for case in mine if case["withheld"] != "nothing"]
        rows.append([plant, *(f"{sum(case['right'] == 'yes' for case in some)} of {len(some)}" for some in (lost, whole))])
    return _table(["measured machine", "withheld element named first", "whole model: `no_gap`"], rows)


def _mirror() -> str:
    rows = []
    for title, (table, subject) in MIRROR.items():
        found = _lookup("fsm_cubespec", table)
        published = title != "linear, one model"
        rows.append([title, *(_beside(found[level, subject, "relative_error"], published=published) for level in LEVELS)])
    found = _lookup("fsm_cubespec", "One model for all levels by the benchmark's measure, realization 6")
    whole = [found[level, "all outputs and periods", "rmse"] for level in LEVELS]
    rows.append(["the same by the benchmark's measure, um rms", *(f"{row.value:.3f} ({row.published:.3f})" for row in whole)])
    return _table(["error, % of rms (published)", *LEVELS], rows)


def _oscillator() -> str:
    found = _lookup("bouc_wen", "Simulation error on the records for scoring")
    return _table(
        ["rms error, m", "multisine", "sine sweep"],
        [
            [title, *(f"{found[case, subject, 'rms_error'].value:.1e}" for case in ("multisine", "sine sweep"))]
            for title, subject in OSCILLATORS.items()
        ],
    )


def _lookup(name: str, table: str) -> dict[tuple[str, str, str], Row]:
    return {(row.case, row.subject, row.quantity): row for row in rows_of(name) if row.table == table}


def _beside(row: Row, published: bool = True) -> str:
    return f"{row.value:.2f}" + (f" ({row.published:.2f})" if published and row.published is not None else "")


def _table(headers: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(headers)
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def draw(folder: Path) -> None:
    """Draw the two figures of tracking and of the mirror's models."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    plt.rcParams |= {"svg.hashsalt": "hyst_control", "svg.fonttype": "none", "font.size": 9}
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
    found = _lookup("hampi", "HAMPI Table 5")
    for name, color in (("HAPI", "tab:orange"), ("HAMPI", "tab:blue")):
        rows = [found[frequency, f"{name}, paper", "nrmse"] for frequency in FREQUENCIES]
        hertz = [float(frequency.split()[0]) for frequency in FREQUENCIES]
        left.plot(hertz, [row.value for row in rows], "o-", color=color, label=name)
        left.plot(hertz, [row.published for row in rows], "o--", color=color, mfc="none", label=f"{name}, published")
    left.set(xlabel="frequency, Hz", ylabel="NRMSE, %", yscale="log", ylim=(0.2, 40), title="HAMPI: tracking 4 um in open loop")
    left.legend(fontsize=7, ncols=2, loc="upper center")
    found = _lookup("mhl", "MHL Table 4")
    for place, (title, subject) in enumerate(CONTROLLERS.items()):
        values = [found[reference, subject, "nrmse"].value for reference in REFERENCES]
        right.bar([index + 0.2 * place for index in range(len(values))], values, 0.18, label=title)
    right.set_xticks([index + 0.3 for index in range(len(REFERENCES))], list(REFERENCES.values()))
    right.set(ylabel="NRMSE, %", yscale="log", ylim=(0.01, 40), title="MHL: composite control")
    right.legend(fontsize=7, ncols=2, loc="upper center")
    _save(figure, folder / "results_tracking.svg")

    figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    for place, (title, (table, subject)) in enumerate(MIRROR.items()):
        found = _lookup("fsm_cubespec", table)
        rows = [found[level, subject, "relative_error"] for level in LEVELS]
        axes.bar([index + 0.25 * place for index in range(len(rows))], [row.value for row in rows], 0.22, label=title)
        if title != "linear, one model":
            for index, row in enumerate(rows):
                axes.plot(index + 0.25 * place, row.published, "k_", ms=14, label="published" if place == index == 0 else None)
    axes.set_xticks([index + 0.25 for index in range(len(LEVELS))], list(LEVELS))
    axes.set(xlabel="level of the command, rms", ylabel="simulation error, % of rms")
    axes.legend(fontsize=7, loc="upper center")
    _save(figure, folder / "results_mirror.svg")


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None})
    print(f"written: {path}")


if __name__ == "__main__":
    for name, text in tables().items():
        print(f"\n{name}\n\n{text}")
    draw(DOCS / "figures")
