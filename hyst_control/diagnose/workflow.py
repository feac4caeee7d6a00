"""From bags and a model file to the report, its page and the augmented model: what the command and the node call."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.diagnose.report.attribution import attribute
from hyst_control.diagnose.report.augmented_model import augmented as augmented_model
from hyst_control.diagnose.report.block_replay import replay
from hyst_control.diagnose.report.document import gap_report, in_words
from hyst_control.diagnose.report.invalid_records import invalid_report, write_invalid_page
from hyst_control.diagnose.report.predicted_reduction import foresee
from hyst_control.diagnose.report.unknown_remainder import remainder_of, with_learned_residual
from hyst_control.diagnose.run.diagnosis import Diagnosis, diagnose
from hyst_control.effects import EFFECTS
from hyst_control.errors import InputError
from hyst_control.files import write_json
from hyst_control.model_file import Model, load_model, save_model
from hyst_control.progress import step
from hyst_control.records.array_files import read_array
from hyst_control.records.bag_reader import read_bag
from hyst_control.records.record import Record
from hyst_control.reporting.provenance import provenance


def diagnose_bags(
    bags: Sequence[str | Path],
    model: str | Path | None = None,
    json: str | None = None,
    report: str | None = None,
    augmented: str | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    cache: bool = True,
    namespace: str | None = None,
    unit: str = "unknown",
    progress: bool = False,
    warm_up: float = 0.0,
    on: str | None = None,
    baseline: Sequence[str | Path] = (),
    learned_residual: bool = False,
) -> str:
    """Diagnose bags and write what is asked for."""
    for name in without:
        if name not in EFFECTS:
            raise InputError(f"--without {name}: no such effect, one of {', '.join(EFFECTS)} is due")
    for path in (json, report, augmented):
        if path is not None and not Path(os.path.realpath(path)).parent.is_dir():
            raise InputError(f"{path}: {Path(os.path.realpath(path)).parent} is no folder: choose one that exists")
    if learned_residual and augmented is None:
        raise InputError("--learned-residual: is a stage of the augmented model: give --augmented with the file to write")
    nominal = None if model is None else load_model(model)
    records = [read_bag(bag, namespace, unit) for bag in bags]
    clean = [read_bag(bag, namespace, unit) for bag in baseline]
    coming = None if on is None else _command(on, namespace, unit)
    if nominal is not None and (refused := invalid_report(records, nominal)) is not None:
        if report is not None:
            write_invalid_page(report, refused[0], provenance([("record", bags), ("model", [] if model is None else [model])]))
        if json is not None:
            write_json(json, refused[0])
        return refused[1]
    document, diagnosis, better = diagnosed(
        records, nominal, seed, without, cache, augmented, progress, warm_up, clean, learned_residual
    )
    if coming is not None:
        try:
            document["foreseen"] = {"command": str(on), **foresee(diagnosis, coming).document()}
        except InputError as error:
            raise InputError(f"--on {on}: {error}") from None
    if augmented is not None and better is not None:
        save_model(better, augmented)
    if json is not None:
        write_json(json, document)
    if report is not None:
        from hyst_control.diagnose.report.page import write_page

        origins = provenance(
            [
                ("record", bags),
                ("model", [] if model is None else [model]),
                ("clean records", baseline),
                ("augmented model", [augmented] if augmented is not None and better is not None else []),
                ("report as JSON", [] if json is None else [json]),
            ],
            [("seed", str(seed)), *([] if nominal is None else [("model's name", nominal.name)])],
        )
        write_page(Path(report), document, diagnosis, better, origins)
    return in_words(document)


def diagnosed(
    records: Sequence[Record],
    model: Model | None,
    seed: int = 0,
    without: Sequence[str] = (),
    cache: bool = True,
    augmented: str | None = None,
    progress: bool = False,
    warm_up: float = 0.0,
    baseline: Sequence[Record] = (),
    learned_residual: bool = False,
) -> tuple[dict[str, Any], Diagnosis, Model | None]:
    """Diagnose records, with the report."""
    tell = step if progress else (lambda text: None)
    diagnosis = diagnose(records, model, seed, without, cache, progress=tell, warm_up=warm_up, baseline=baseline)
    tell("shrink on held-out blocks")
    attribution = attribute(diagnosis)
    better = augmented_model(diagnosis) if attribution.effects and model is not None else None
    remainder = remainder_of(diagnosis)
    added = learned_residual and model is not None and remainder is not None and bool(remainder.stages)
    if added and model is not None and remainder is not None:
        better = with_learned_residual(better or replace(model, name=f"{model.name}_augmented"), remainder)
    blocks = [block for record in records for block in replay(record, diagnosis.configuration.replay)]
    document = gap_report(
        diagnosis,
        attribution,
        blocks,
        str(augmented) if augmented and better is not None else None,
        remainder=None if remainder is None else remainder.document(added),
    )
    return document, diagnosis, better


def _command(path: str, namespace: str | None, unit: str) -> NDArray[np.float64]:
    if not path.endswith(".npy"):
        return read_bag(path, namespace, unit).aligned(("command",))[0].values["command"]
    rows = read_array(path)
    return rows[:, None] if rows.ndim == 1 else rows
