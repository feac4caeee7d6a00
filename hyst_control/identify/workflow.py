"""From bags to a model file and a fit report: the one path of the command line, the identification node and scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hyst_control import progress
from hyst_control.errors import InputError
from hyst_control.files import check_writable, write_json
from hyst_control.identify import FAMILIES, PRANDTL_FAMILIES, identify
from hyst_control.identify.dataset import Dataset, Fit
from hyst_control.model_file import COMMAND_UNITS, MEASUREMENT_UNITS, save_model
from hyst_control.records.bag_reader import read_bag
from hyst_control.records.record import Record

NEED = ("command", "measurement")


@dataclass(frozen=True)
class Result:
    """What was identified, and where it was written."""

    fit: Fit
    output: Path

    def text(self) -> str:
        """The fit in a few lines."""
        report = self.fit.report
        lines = [f"{report['family']} ({report['method']}), {', '.join(report.get('structure', []))}"]
        for row in report["records"]:
            lines.append(
                f"  {row['name']}  {row['axis']}: NRMSE {row['nrmse']:.3f} % of range ({row['nrmse_centered']:.3f} % with the "
                f"means removed), NME {row['nme']:.3f} %, RMSE {row['rmse']:.4g} {row['unit']} over {row['samples']} samples"
            )
        if "held_out_nrmse" in report:
            lines.append("  held-out blocks: NRMSE " + ", ".join(f"{value:.3f} %" for value in report["held_out_nrmse"]))
        lines += [f"  note: {note}" for note in report["notes"]]
        return "\n".join([*lines, f"  written: {self.output}"])

    def document(self) -> dict[str, Any]:
        """The fit report."""
        return self.fit.report


def identify_bags(
    bags: Sequence[str | Path],
    family: str | None,
    output: str | Path,
    *,
    json_path: str | Path | None = None,
    method: str = "joint",
    hold: str | None = None,
    start: str = "settled",
    allow_gaps: bool = False,
    namespace: str | None = None,
    unit: str = "unknown",
    **options: Any,
) -> Result:
    """Identify a model from bags and write it; without a family the best on held-out blocks of the Prandtl-Ishlinskii ones.

    Nothing is written unless the fit succeeded. Raises `InputError` naming file, field and remedy.
    """
    check_writable(output)
    if json_path is not None:
        check_writable(json_path)
    if family is not None and family not in FAMILIES:
        raise InputError(f"model: {family!r} is not a model family: one of {', '.join(FAMILIES)} is due")
    datasets, notes = [], []
    for bag in bags:
        progress.step(f"read {bag}")
        record = read_bag(bag, namespace, unit)
        notes += record.notes
        datasets += datasets_of(record, hold, start, allow_gaps)
    chosen = {key: value for key, value in options.items() if value is not None and value is not False}
    if isinstance(chosen.get("thresholds"), str):
        chosen["thresholds"] = _numbers(chosen["thresholds"])
    if family is None:
        fit = min(
            (identify(datasets, name, **chosen) for name in PRANDTL_FAMILIES), key=lambda fit: max(fit.report["held_out_nrmse"])
        )
    else:
        fit = identify(datasets, family, method, **(chosen if family in PRANDTL_FAMILIES else {}))
    fit = replace(fit, report={**fit.report, "bags": [str(bag) for bag in bags], "notes": [*notes, *fit.report["notes"]]})
    save_model(fit.model, output)
    if json_path is not None:
        write_json(json_path, fit.report)
    return Result(fit, Path(output))


def datasets_of(record: Record, hold: str | None = None, start: str = "settled", allow_gaps: bool = False) -> list[Dataset]:
    """The gapless stretches of a record as datasets. Raises `InputError` when topics, units or samples are unusable.

    start: "settled" at the first command, reached from 0 V on the virgin curve, or "unknown"; what follows a gap is unknown.
    """
    command, measurement = (record.signal(topic) for topic in NEED)
    if command.unit not in COMMAND_UNITS:
        raise InputError(
            f"{record.source}: command: unit {command.unit!r}, {' or '.join(COMMAND_UNITS)} is due: import it with its unit"
        )
    if measurement.unit not in MEASUREMENT_UNITS:
        raise InputError(
            f"{record.source}: measurement: unit {measurement.unit!r}, {' or '.join(MEASUREMENT_UNITS)} is due: import it "
            "with its unit, or name the unit of a bag without a layout"
        )
    if command.axes != measurement.axes:
        raise InputError(
            f"{record.source}: command has axes {', '.join(command.axes)}, measurement {', '.join(measurement.axes)}: "
            "both need the same axes in the same order"
        )
    datasets = []
    for index, part in enumerate(record.aligned(NEED, allow_gaps)):
        name = Path(record.source).name + (f"[{index}]" if index else "")
        data = Dataset(
            name,
            part.values["command"],
            part.values["measurement"],
            part.sample_time,
            measurement.axes,
            measurement.unit,
            hold or record.hold,
            "unknown" if index else start,
        )
        datasets.append(data)
    return datasets


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"thresholds: {text!r}: numbers in V separated by commas are due") from None
