"""Scores and page of the cases that are injected into measured records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.reporting.tables import Table

MODES = ("none", "other_command", "same_command")
"""Clean records beside the new one."""
SIZES = (1.0, 3.0, 10.0)
"""Sizes of the effects, as multiples of the model's own error."""
COMPANIONS = ("offset", "offset_drift")
LAGS = ("delay", "sensor_lowpass", "amplifier_lowpass")
"""Effects that count as one name where the record has one frequency."""
EQUAL = {"gain": ("hysteresis_width",), "dac_hold": ("sensor_noise",), "sensor_noise": ("flicker_noise",)}
"""Names that an engineer would accept as well."""
ABOUT = """Injected cases: known effects put into measured records, so that the physics is real and the truth exact.

Effects of the sensor act on the measurement; effects of the drive that can be inverted act backwards on the command: the recorded command
u is what the effect made of another one, c, and c takes its place. Every size is a multiple of what the identified model leaves on clean
records that it was not identified from. The records:

- stack (`pea_p885`): eight cycles each, the first two of which fill the memory. Models are identified from full cycles of the first file
and from two stretches of the second, cases come from other stretches; tuning seeds see stretches of the second file's first half, scoring
seeds of its second half, where an inverse operator shaped the command. The repeated full cycles have clean records of the same command.
- mirror (`fsm_cubespec`): three levels; models from realizations 1-4, tuning seeds see the fifth, scoring seeds the sixth. The period of
a record is repeated, that of its clean record is the other measured one.

The effects are written with numpy and scipy alone: nothing is shared with the catalogue that is tested.
"""
TITLE = "Injected into measured records"


def score(rows: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Table:
    """Score reports against their labels.

    Parameters
    ----------
    rows
        Label and report by case.

    Returns
    -------
    Table
        Fractions with their numbers, by clean records and size.
    """
    from hyst_control.blind_test.scores import wilson

    table = Table("blind-test --injected")

    def add(case: str, subject: str, quantity: str, hits: Sequence[bool]) -> None:
        right = sum(hits)
        table.add(TITLE, case, subject, quantity, "", right / len(hits), n=len(hits), ci95=wilson(right, len(hits)))

    for mode in MODES:
        ours = [(label, report) for label, report in rows if label["mode"] == mode]
        for size in SIZES:
            singles = [pair for pair in ours if pair[0]["kind"] == "single" and pair[0]["multiple"] == size]
            if singles:
                add(mode, f"{size:g} x own error", "top_1", [named_right(*pair) for pair in singles])
        for kind, quantity, judge in (
            ("pair", "at_least_one", named_right),
            ("open_set", "unknown", lambda label, report: report["verdict"] == "unknown"),
            ("none", "false_alarm", lambda label, report: not quiet(report)),
        ):
            some = [pair for pair in ours if pair[0]["kind"] == kind]
            if some:
                add(mode, kind, quantity, [judge(*pair) for pair in some])
    if rows:
        seconds = [report["seconds"] for _, report in rows]
        table.add(TITLE, "all", "diagnosis", "seconds_median", "s", float(np.median(seconds)), n=len(seconds))
    return table


def named_right(label: Mapping[str, Any], report: Mapping[str, Any]) -> bool:
    """Report whether the first name is that of an injected effect, and the verdict names effects.

    Parameters
    ----------
    label
        Label of the case.
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    named = [effect["name"] for effect in report["effects"]]
    accepted = {name for one in label["names"] for name in (one, *EQUAL.get(one, ()))}
    if label["one_frequency"] and accepted & set(LAGS):
        accepted |= set(LAGS)
    companion = bool(accepted & set(COMPANIONS))
    first = next((name for name in named if companion or name not in COMPANIONS), None)
    return report["verdict"] in ("effect", "ambiguous") and first in accepted


def quiet(report: Mapping[str, Any]) -> bool:
    """Report whether a diagnosis of a clean record names nothing but coefficients and companions.

    Parameters
    ----------
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    if report["verdict"] in ("no_gap", "parameters"):
        return True
    return report["verdict"] == "effect" and all(effect["name"] in COMPANIONS for effect in report["effects"])


def write_page(
    path: Path, rows: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], table: Table, seed: int, count: int, digest: str
) -> None:
    """Write the page of a run.

    Parameters
    ----------
    path
        File to write.
    rows
        Label and report by case.
    table
        The figures.
    seed, count
        Seed and number of the cases.
    digest
        SHA-256 of the labels.
    """
    from hyst_control.files import write_text

    lines = [
        "# The diagnosis on measurements, an effect injected",
        "",
        f"Generated by `hyst blind-test --injected --seed {seed} --count {count} --page`; labels: SHA-256 `{digest}`.",
        "",
        *ABOUT.strip().splitlines(),
        "",
        "| clean records | cases | figure | value | number |",
        "|---|---|---|---|---|",
        *(f"| {row.case} | {row.subject} | {row.quantity} | {row.value:.2f} | {row.n} |" for row in table.rows),
        "",
        "| case | plant | clean records | injected | size | verdict | named |",
        "|---|---|---|---|---|---|---|",
    ]
    for label, report in rows:
        injected = ", ".join(
            f"{name} ({how})" if how else name for name, how in zip(label["names"], label["realizations"], strict=True)
        )
        named = ", ".join(effect["name"] for effect in report["effects"])
        lines.append(
            f"| {label['name']} | {label['plant']} | {label['mode']} | {injected or 'nothing'} | {label['multiple']:g} | "
            f"{report['verdict']} | {named} |"
        )
    write_text(path, "\n".join(lines) + "\n")
