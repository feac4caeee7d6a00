# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification from bags to a model file and a fit report, as used by the command line, the identification node and scripts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import check_writable, write_json
from hyst_control.identify import estimator_of, estimators, identify
from hyst_control.identify.assess.attainable import leaves_noise, poorly_explained
from hyst_control.identify.assess.explained_share import (
    DISAGREE,
    EXPLAINS,
    INVALID,
    NOTHING,
    POORLY,
    explained_shares,
    sentence,
    useless,
)
from hyst_control.identify.assess.fit_report import residual
from hyst_control.identify.assess.imitated_hysteresis import imitated_hysteresis
from hyst_control.identify.assess.model_choice import POOR, best_family, choice_lines
from hyst_control.identify.assess.record_consistency import disagreements
from hyst_control.identify.data.dead_time import lateness, taken_earlier, with_delay
from hyst_control.identify.data.fit import Fit, Report
from hyst_control.identify.data.hold_choice import hold_errors
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.model_error.learned_discrepancy import discrepancy_of
from hyst_control.model_file import USUAL_UNITS, Model, save_model
from hyst_control.records.bags.bag_files import bags_in
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.losses import losses
from hyst_control.records.record import TOPICS, Record
from hyst_control.records.stream.clock_alignment import aligned_by_reception
from hyst_control.records.tables.units import refusal_of_unit
from hyst_control.records.validity.checks import examined, refuse_invalid
from hyst_control.records.validity.findings import Trial

AUTO = "auto"  # In place of a family: the best one
BY_THEMSELVES = (
    "the axes were fitted by themselves: where the command of one moves another, name a family that couples axes, such as --model mhl "
    "or --model linear"
)
"""Note on several axes where no family was named."""
LONGEST_JUDGED = 2**22
"""Rows of a record, from its beginning, by which it is judged whether it is a measurement of its command: 84 s at 50 kHz."""

MAX_NOTES = 5  # Lines of notes on a terminal
SHORTEST_SHARE, SHORTEST_STRETCH = 0.05, 32
"""Least length of a stretch between gaps that is used: share of the longest one, and samples."""


@dataclass(frozen=True)
class Result:
    """An identified model and its file."""

    fit: Fit  # Model and report
    output: Path | None  # The file it was written to; None where the model explains nothing and was not
    strict: bool = False  # Whether a verdict other than "explains" is a failure of the command

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 3 where `strict` and the verdict is not "explains", 2 where no model was written, else 0."""
        if self.strict and self.fit.report["verdict"] != EXPLAINS:
            return 3
        return 0 if self.output is not None else 2

    @property
    def refusal(self) -> str:
        """Reason for which no model was written; "" where one was."""
        return "" if self.output is not None else f"{self.fit.report['notes'][0]}: no model is written (--force writes it)"

    def written(self) -> Path:
        """The model file. Raises `InputError` where there is none."""
        if self.output is None:
            raise InputError(self.fit.report["notes"][0])
        return self.output

    def text(self) -> str:
        """Summarize the fit in a few lines."""
        written = "no model is written (--force writes it)" if self.output is None else f"written: {self.output}"
        return f"{fit_text(self.fit.report)}\n  {written}"

    def document(self) -> Report:
        """The fit report."""
        return self.fit.report


def fit_text(report: Report) -> str:
    """Summarize a fit in a few lines."""
    lines = [", ".join([f"{report['family']} ({report['method']})", *report.get("structure", [])])]
    for row in report["records"]:
        rms = row["rmse"] * row["nrmse_own_zero"] / (row["nrmse"] or 1.0)
        lines.append(
            f"  {row['name']}  {row['axis']}: NRMSE {row['nrmse_own_zero']:.3f} % of range, RMSE {rms:.4g} {row['unit']} over "
            f"{row['samples']} samples, without the session's offset {row['zero']:.4g} {row['unit']} and drift {2.0 * row['drift']:.4g} "
            f"{row['unit']} over the record; NME {row['nme']:.3f} % of range with them"
        )
    lines += [
        f"  {row['name']} begins {row['assumed']}" + f", row {row['first_row']}" * bool(row["first_row"])
        for row in report.get("beginnings", [])
    ]
    if "held_out_nrmse" in report:
        lines.append("  held-out blocks: NRMSE " + ", ".join(f"{value:.3f} %" for value in report["held_out_nrmse"]))
    if "tried" in report:
        lines += choice_lines(report["tried"])
    notes = report["notes"]
    shown = notes if len(notes) <= MAX_NOTES else notes[: MAX_NOTES - 1]
    lines += [f"  note: {note}" for note in shown]
    if len(shown) < len(notes):
        lines.append(f"  note: {len(notes) - len(shown)} more are in the report (--json)")
    return "\n".join(lines)


def identify_bags(
    bags: Sequence[str | Path],
    family: str | None,
    output: str | Path,
    *,
    json_path: str | Path | None = None,
    method: str = "joint",
    hold: str | None = None,
    start: str = "auto",
    allow_gaps: bool = False,
    force: bool = False,
    namespace: str | None = None,
    unit: str = "unknown",
    columns: str | None = None,
    figure: str | Path | None = None,
    strict: bool = False,
    shift: float = 0.0,
    **options: object,
) -> Result:
    """Identify a model from bags and write it. No model is written that explains less of the records than a constant and a gain."""
    check_writable(output)
    if json_path is not None:
        check_writable(json_path)
    given = {name: value for name, value in options.items() if value is not None}
    named = family not in (None, AUTO)
    chosen_families(family, method, given)  # refuses what cannot be identified before anything is read
    if figure is not None:
        if named:
            raise InputError(f"figure: shows the choice between families, of which {family} is named: leave the figure out")
        check_writable(figure)
    records = []
    for bag in bags_in(bags):
        progress.step(f"read {bag}")
        records.append(read_bag(bag, namespace, unit, columns=columns).shifted(shift))
    fit = identify_records(records, family, method=method, hold=hold, start=start, allow_gaps=allow_gaps, force=force, **given)
    fit = replace(fit, report={**fit.report, "bags": [str(bag) for bag in bags]})
    keep = force or fit.report["verdict"] != NOTHING
    if keep:
        save_model(fit.model, output)
    if json_path is not None:
        write_json(json_path, fit.report)
    if figure is not None:
        from hyst_control.identify.assess.choice_figure import choice_panels
        from hyst_control.reporting.signal_figures import write_drawing  # takes a second

        write_drawing(choice_panels(fit.report), figure, f"choice of {fit.model.name}")
    return Result(fit, Path(output) if keep else None, strict)


def identify_records(
    records: Sequence[Record],
    family: str | None = None,
    *,
    method: str = "joint",
    hold: str | None = None,
    start: str = "auto",
    allow_gaps: bool = False,
    force: bool = False,
    **options: object,
) -> Fit:
    """Identify a model from records, and judge what it explains of them; the parameters are those of `identify_bags`."""
    lost, notes = losses(records)
    cut: list[Record] = []
    for record in records:
        record = aligned_by_reception(record, TOPICS)
        notes += record.notes
        cut += gapless_records(record, hold, start, allow_gaps, notes)
    cut = with_one_hold(cut, notes)
    looked_at = [each.rows(0, LONGEST_JUDGED) for each in cut]
    trials = [Trial(each.name, each.command, each.measurement, each.sample_time, each.axes, unit=each.unit) for each in looked_at]
    found, remarks = examined(trials) if force else ([], refuse_invalid(trials))
    notes += [each.text() for each in remarks]
    late = lateness(remarks, cut)
    begun = [with_beginning(taken_earlier(data, late)) for data in cut]
    try:
        fit = identified(begun, family, method, **options)
    except InputError as error:
        raise InputError("; ".join([str(error), *(each.text() for each in remarks)])) from None
    errors = residuals_of(fit, begun)
    shares = explained_shares(begun, errors)
    poor = [] if useless(shares) else poorly_explained(begun, errors)
    imitated = [] if useless(shares) else imitated_hysteresis(fit.model, begun, errors)
    is_poor = bool(poor) or any(each.surely for each in imitated)
    differing = [each.text() for each in disagreements(fit.model, begun, errors)]
    verdict = INVALID if found else NOTHING if useless(shares) else DISAGREE if differing else POORLY if is_poor else EXPLAINS
    mixed = any(stage.mixes_axes for stage in fit.model.chain.stages)
    notes = [
        *(each.text() for each in found),
        *(sentence(row) for row in useless(shares)),
        *(each.text() for each in poor),
        *(each.text() for each in imitated),
        *notes,
        *differing,
        *fit.report["notes"],
        *([BY_THEMSELVES] if family in (None, AUTO) and len(fit.model.axes) > 1 and not mixed else []),
    ]
    report: Report = {**fit.report, "verdict": verdict, "explained": shares, "losses": lost, "notes": notes}
    return with_delay(replace(fit, report=report), late * begun[0].sample_time)


def identified(records: Sequence[Record], family: str | None = None, method: str = "joint", **options: object) -> Fit:
    """Identify a model with its model discrepancy, the best family unless one is named."""
    chosen = chosen_families(family, method, options)
    begun = [with_beginning(data) for data in records]
    if family not in (None, AUTO):
        fit = identify(begun, chosen[0], method, **options)
    else:

        def further(best: Fit) -> list[str]:
            """Families to try beside a poor one: where it leaves noise, only such as are plainer."""
            errors = residuals_of(best, begun)
            is_noise = leaves_noise(begun, errors, POOR / 100.0)
            linear = is_noise or any(each.linear for each in poorly_explained(begun, errors))
            return [
                name
                for name, each in estimators().items()
                if each.is_promising(len(begun[0].axes), linear) and each.has(options) and not (is_noise and each.second_choice)
            ]

        def explains(fit: Fit) -> bool:
            return not useless(explained_shares(begun, residuals_of(fit, begun)))

        fit = best_family(chosen, lambda name: identify(begun, name, method, **options), further, explains)
    left = residuals_of(fit, begun)
    units = {"command": records[0].command_unit, "measurement": records[0].unit}
    report = fit.report if units["command"] == "V" else _in_command_unit(fit.report, units)
    model = replace(fit.model, units=units, discrepancy=discrepancy(fit.model, begun, left))
    return replace(fit, model=model, report=report, residuals=tuple(left))


def _in_command_unit(report: Any, units: Mapping[str, str]) -> Any:
    """A report whose parameters are in the command's unit where the families write V."""
    if isinstance(report, list):
        return [_in_command_unit(row, units) for row in report]
    if not isinstance(report, dict):
        return report
    volts = r"(?<=/)V\b" if units["measurement"] == "V" else r"\bV\b"
    return {
        key: re.sub(volts, units["command"], value) if key == "unit" and isinstance(value, str) else _in_command_unit(value, units)
        for key, value in report.items()
    }


def residuals_of(fit: Fit, records: Sequence[Record]) -> Sequence[Array]:
    """Residuals of a fit on its records, simulated again only where the family did not hand them on."""
    return fit.residuals or [residual(fit.model, data) for data in records]


def discrepancy(model: Model, records: Sequence[Record], left: Sequence[Array] | None = None) -> dict[str, Any]:
    """The model discrepancy in the form of a model file, from what it leaves (N, A) of its records, simulated unless it is known."""
    left = [residual(model, data) for data in records] if left is None else left
    measured = [data.measurement[-len(rows) :] for data, rows in zip(records, left, strict=True)]
    return discrepancy_of([data.command for data in records], left, records[0].sample_time, measured)


def chosen_families(family: str | None, method: str, options: Mapping[str, object]) -> list[str]:
    """Choose the families to identify: the one named, or all that are compared and have the options given."""
    if family is not None and family != AUTO:
        estimator_of(family).options(method=method, **options)
        return [family]
    compared = {name: each for name, each in estimators().items() if each.suggested}
    if method != "joint":
        raise InputError(f"method: must be joint where no model is named, got {method}: name a model")
    having = [name for name, each in compared.items() if each.has(options)]
    if not having:
        raise InputError(
            f"{', '.join(options)}: not an option of any of {', '.join(compared)}, of which the best is chosen: name a model"
        )
    for name in having:
        compared[name].options(method=method, **options)
    return having


def gapless_records(
    record: Record, hold: str | None = None, start: str = "auto", allow_gaps: bool = False, notes: list[str] | None = None
) -> list[Record]:
    """Cut a record into gapless ones."""
    # start: "settled" at the first command, reached from 0 V on the initial loading curve, "unknown", or "auto", found from the record;
    # what follows a gap is unknown
    # allow_gaps: use the stretches between lost samples instead of raising an error; those that are short beside the longest are
    # left out
    for topic, usual in USUAL_UNITS.items():
        if reason := refusal_of_unit(record.signal(topic).unit, usual):
            raise InputError(
                f"{record.source}: {topic}: unit {reason}: import it with its unit, or name the unit of a bag without a layout"
            )
    record.check_axes()
    if hold not in (None, AUTO):
        record = replace(record, hold=hold, states_hold=True)
    record = replace(record, start=record.start if start == AUTO else start)
    return _long_enough(record.aligned(allow_gaps=allow_gaps), record.source, notes)


def with_one_hold(records: Sequence[Record], notes: list[str] | None = None) -> list[Record]:
    """Records of one machine with one hold: that of those that state theirs, else pairs if the longest answers commands of its own rows."""
    stated = {data.hold for data in records if data.states_hold}
    if all(data.states_hold for data in records) or len(stated) > 1:
        return list(records)
    if stated:
        hold = stated.pop()
    else:
        longest = max(records, key=lambda data: len(data.command))
        errors = hold_errors(longest)
        hold = "foh" if errors.own_row else "zoh"
        if errors.own_row and notes is not None:
            notes.append(
                f"{longest.name}: hold foh: the measurement answers the command of its own row, with which {100 * errors.same:.2g} % of "
                f"the range are left, {100 * errors.late:.2g} % with that of rows before (--hold zoh)"
            )
    return [data if data.states_hold else replace(data, hold=hold) for data in records]


def _long_enough(stretches: list[Record], source: str, notes: list[str] | None) -> list[Record]:
    """The stretches that are long enough to tell something."""
    longest = max(map(len, stretches))
    used = [each for each in stretches if len(each) >= min(max(SHORTEST_SHARE * longest, SHORTEST_STRETCH), longest)]
    if len(used) < len(stretches) and notes is not None:
        total = sum(map(len, stretches))
        notes.append(
            f"{source}: {len(stretches) - len(used)} of {len(stretches)} stretches between gaps, {total - sum(map(len, used))} of "
            f"{total} samples, are too short to be used"
        )
    return used
