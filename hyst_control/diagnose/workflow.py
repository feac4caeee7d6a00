# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""From bags and a model file to the report, its page and the augmented model: what the command and the node call."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import check_writable, write_json
from hyst_control.base.parallel import beside
from hyst_control.base.progress import step
from hyst_control.chain.external_simulator import Simulate
from hyst_control.diagnose.problem.coefficient_prior import names_that_scatter
from hyst_control.diagnose.report.attribution import attribute
from hyst_control.diagnose.report.augmented_model import augmented as augmented_model
from hyst_control.diagnose.report.block_replay import replay
from hyst_control.diagnose.report.document import gap_report, in_words
from hyst_control.diagnose.report.gap_breakdown import budget
from hyst_control.diagnose.report.gap_structure import gap_structure
from hyst_control.diagnose.report.invalid_records import invalid_report, write_invalid_page
from hyst_control.diagnose.report.predicted_reduction import foresee
from hyst_control.diagnose.report.unknown_remainder import remainder_of, with_learned_residual
from hyst_control.diagnose.run.diagnosis import BY_REGIME, Diagnosis, diagnose, outside_valid
from hyst_control.diagnose.simulator import named_simulator, of_function, read_parameters, simulator_model, simulator_notes
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, load_model, save_model
from hyst_control.records.bags.bag_files import bags_in
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.losses import losses
from hyst_control.records.record import TOPICS, Record
from hyst_control.records.tables.array_files import read_array
from hyst_control.records.tables.regular_signals import RATES_DIFFER
from hyst_control.reporting.provenance import Origin, provenance
from hyst_control.reporting.signal_figures import Line, Panel, thinned

REFITTED = 0.1
"""Tolerance of coefficients that were fitted to the records themselves: without an effect that these show they are off by some per cent."""


@dataclass(frozen=True)
class GapResult:
    """A diagnosed gap: its report, and what the page is drawn from."""

    document: dict[str, Any]  # The gap report
    words: str  # The same in words
    diagnosis: Diagnosis | None = None  # None where the record is no measurement of its command
    better: Model | None = None  # The model with the effects added; None where none was named or this comes no closer

    def panels(self) -> list[Panel]:
        """Measured against simulated signals and the gap, of every piece and axis, with the effects added where there are some."""
        if self.diagnosis is None:
            raise InputError("the record is no measurement of its command: there is no gap to draw")
        from hyst_control.diagnose.report.page import traces_of

        model, panels = self.diagnosis.model, []
        unit = model.units["measurement"]
        for piece in traces_of(self.diagnosis, self.better):
            curves = {"with the effects" if name == "augmented" else name: values for name, values in piece.curves.items()}
            for index, axis in enumerate(model.axes):
                label = f" {axis}" if len(model.axes) > 1 else ""
                drawn = {"measured": piece.measured, **curves}
                left = {name: piece.measured - values for name, values in curves.items()}
                for title, signals in (("measurement", drawn), ("gap", left)):
                    lines = tuple(Line(name, *thinned(piece.time, values[:, index])) for name, values in signals.items())
                    panels.append(Panel("time [s]", f"{title}{label} [{unit}]", lines))
        return panels

    def write_page(self, path: str | Path, origins: Sequence[Origin] = ()) -> None:
        """Write the HTML page of the gap."""
        if self.diagnosis is None:
            write_invalid_page(Path(path), self.document, origins)
            return
        from hyst_control.diagnose.report.page import write_page

        write_page(Path(path), self.document, self.diagnosis, self.better, origins)


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
    columns: str | None = None,
    progress: bool = False,
    warm_up: float = 0.0,
    on: str | None = None,
    baseline: Sequence[str | Path] = (),
    learned_residual: bool = False,
    core: str = BY_REGIME,
    own_records: bool = False,
    simulator: str | None = None,
    parameters: str | Path | None = None,
    shift: float = 0.0,
) -> GapResult:
    """Diagnose bags and write what is asked for."""
    for path in (json, report, augmented):
        if path is not None:
            check_writable(path)  # before a diagnosis that may take minutes
    if learned_residual and simulator is not None:
        raise InputError("--learned-residual: is a stage of a model file, which a Python function is not: leave it out")
    if learned_residual and augmented is None:
        raise InputError("--learned-residual: is a stage of the augmented model: give --augmented with the file to write")
    if simulator is None and parameters is not None:
        raise InputError(f"--parameters {parameters}: are those of a simulator: give --simulator module:function")
    if simulator is not None and (other := model or augmented) is not None:
        raise InputError(f"{other}: a Python function is no model file: leave it out, or leave out --simulator")
    records = [read_bag(bag, namespace, unit, columns=columns).shifted(shift) for bag in bags_in(bags)]
    nominal = None if model is None else load_model(model)
    if simulator is not None:
        prior = {} if parameters is None else read_parameters(parameters)
        nominal = simulator_model(named_simulator(simulator), prior, records)
    gap = diagnose_records(
        records,
        nominal,
        [read_bag(bag, namespace, unit, columns=columns) for bag in bags_in(baseline)],
        seed=seed,
        without=without,
        cache=cache and simulator is None,  # the threshold is kept for a model file, whose content is known
        augmented=augmented,
        progress=progress,
        warm_up=warm_up,
        learned_residual=learned_residual,
        core=core,
        own_records=own_records,
        coming=None if on is None else (str(on), _command(on, namespace, unit, columns, records[0].common_step(TOPICS))),
    )
    written = []
    if augmented is not None and gap.better is not None:
        save_model(gap.better, augmented)
        written = [augmented]
    if json is not None:
        write_json(json, gap.document)
    if report is not None:
        files: list[tuple[str, Sequence[str | Path]]] = [
            ("record", bags),
            ("model", [path for path in (model, parameters) if path is not None]),
            ("baseline records", baseline),
            ("augmented model", written),
            ("report as JSON", [] if json is None else [json]),
        ]
        names = [("seed", str(seed)), *([] if nominal is None else [("model's name", nominal.name)])]
        gap.write_page(report, provenance(files, names))
    return gap


def diagnose_records(
    records: Sequence[Record],
    model: Model | None,
    baseline: Sequence[Record] = (),
    *,
    coming: tuple[str, Array] | None = None,
    **settings: Any,
) -> GapResult:
    """Diagnose records that are measurements of their command; say so of those that are none."""
    # coming: name and rows (N, A) of the command of a future run. settings: as `diagnosed` has them
    _check_effects(settings.get("without", ()))
    said = simulator_notes(model, records)
    records, baseline = ([of_function(model, record) for record in each] for each in (records, baseline))
    lost, notes = losses([*records, *baseline])
    with beside(lambda: (None, []) if model is None else invalid_report(records, model)) as checked:

        def go_on() -> None:
            if checked.is_known() and checked.result()[0] is not None:
                raise InputError("the record is no measurement of its command")

        error = None
        try:
            go_on()
            document, diagnosis, better = diagnosed(records, model, baseline=baseline, go_on=go_on, **settings)
        except Exception as raised:  # of a record that is refused it does not matter
            error = raised
        refused, remarks = checked.result()
    if refused is not None:
        document, words = refused
        document["notes"] += said
        return GapResult(document, "\n".join([words, *(f"  {each}" for each in said)]))
    if error is not None:
        raise error
    document["notes"] = [*notes, *remarks, *said, *document["notes"]]
    document["losses"] = lost
    if coming is not None:
        try:
            document["foreseen"] = {"command": coming[0], **foresee(diagnosis, coming[1]).document()}
        except InputError as error:
            raise InputError(f"--on {coming[0]}: {error}") from None
        if beyond := outside_valid(diagnosis.model, coming[1]):
            document["notes"].append(
                f"--on {coming[0]}: {beyond}: the reduction is that of an extrapolation; check the command's unit"
            )
    return GapResult(document, in_words(document), diagnosis, better)


def _check_effects(without: Sequence[str]) -> None:
    """Refuse names of effects that do not exist."""
    if isinstance(without, str):
        raise InputError(f"without: {without!r}, must be a list of effects: give [{without!r}]")
    for name in without:
        if name not in EFFECTS:
            raise InputError(f"without: {name!r} is not an effect: use one of {', '.join(EFFECTS)}")


def diagnose_simulator(
    records: Sequence[Record],
    simulate: Simulate,
    parameters: Mapping[str, Sequence[Any]],
    baseline: Sequence[Record] = (),
    **settings: Any,
) -> GapResult:
    """Diagnose records with a Python function as the model; thresholds are not kept, since its code may change."""
    return diagnose_records(records, simulator_model(simulate, parameters, records), baseline, **{**settings, "cache": False})


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
    core: str = BY_REGIME,
    own_records: bool = False,
    go_on: Callable[[], None] = lambda: None,
) -> tuple[dict[str, Any], Diagnosis, Model | None]:
    """Diagnose records, with the report; of a model's own records what it left when it was identified is the gap."""
    # go_on: called between the steps; what it raises ends the diagnosis
    if own_records and model is not None:
        model = _as_before_identification(model)

    def tell(text: str) -> None:
        go_on()
        if progress:
            step(text)

    diagnosis = diagnose(records, model, seed, without, cache, progress=tell, warm_up=warm_up, baseline=baseline, core=core)
    if model is not None:
        parts = [
            replace(part, structure=gap_structure(diagnosis.problem, part.axes))
            if part.decision.verdict is Verdict.UNKNOWN and not part.structure
            else part  # the core has told the structure, or there is nothing to tell
            for part in diagnosis.parts
        ]
        diagnosis = replace(diagnosis, parts=tuple(parts))
    tell("shrink on held-out blocks")
    with beside(partial(budget, diagnosis)) as split:
        attribution = attribute(diagnosis)
        useful = any(effect.shrink is None or effect.shrink > 0.0 for effect in attribution.effects)
        better = augmented_model(diagnosis) if useful and model is not None else None
        remainder = remainder_of(diagnosis)
        added = False
        if learned_residual and model is not None and remainder is not None and remainder.stages:
            added = True
            better = with_learned_residual(better or replace(model, name=f"{model.name}_augmented"), remainder)
        blocks = [block for record in records for block in replay(record, diagnosis.configuration.replay)]
        document = gap_report(
            diagnosis,
            attribution,
            split.result(),
            blocks,
            str(augmented) if augmented and better is not None else None,
            remainder=None if remainder is None else remainder.document(added),
        )
    return document, diagnosis, better


def _as_before_identification(model: Model) -> Model:
    """The model without the error and the noise that it states, and with coefficients that fits beside an effect may move again."""
    stages = model.chain.stages
    names = {name for stage in stages for name in names_that_scatter(stage)}
    wide = {name: max(float(np.max(model.tolerance.get(name, 0.0))), REFITTED) for name in names if "." not in name}
    return replace(model, discrepancy={}, noise={}, uncertainty={}, tolerance=wide)


def _command(path: str, namespace: str | None, unit: str, columns: str | None, sample_time: float) -> Array:
    """Command rows (N, A) of a future run, which must have the sample time (s) of the records that are diagnosed."""
    if not path.endswith(".npy"):
        [record, *_] = read_bag(path, namespace, unit, columns=columns).aligned(("command",))
        if abs(record.sample_time - sample_time) > RATES_DIFFER * sample_time:
            raise InputError(
                f"--on {path}: has {1.0 / record.sample_time:.6g} samples/s, the records {1.0 / sample_time:.6g}: bring it to their rate "
                f"(hyst edit or hyst import, --resample {1.0 / sample_time:.6g})"
            )
        return record.command
    rows = read_array(path)
    return rows[:, None] if rows.ndim == 1 else rows
