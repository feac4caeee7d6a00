"""The diagnosis on measurements, an effect withheld: models of measured plants that lost one element.

The mirror (`fsm_cubespec`): a linear model per level, fitted on realizations 1-4, its input delay chosen on the fifth, loses its
delay, the coupling of its axes, 5 % of its gain, and each mode in turn; the sixth realization is diagnosed. The error of the
whole model on the fifth is what it states of itself. Then the true unknown: a level's model against the records of a higher
one. The stack (`pea_p885`): a model without hysteresis, and one with too few operators, against the nested loops of another file.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from hyst_control.chain import Chain
from hyst_control.chain.linear import Delay, StateSpace, TransferFunction
from hyst_control.chain.stage import Array, Stage, frozen
from hyst_control.diagnose.gap_report import sentence
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.errors import InputError
from hyst_control.files import write_json, write_text
from hyst_control.identify import identify
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.learned_discrepancy import discrepancy_of
from hyst_control.identify.modal_candidate import Candidate, error_of, refined
from hyst_control.identify.modal_fit import subspace
from hyst_control.identify.workflow import discrepancy
from hyst_control.model_file import Model, model_to_document, simulate
from hyst_control.parallel import map_forked
from hyst_control.records.record import Record, Signal
from hyst_control.reporting.tables import Table
from hyst_control.reproduction import fsm_cubespec as mirror
from hyst_control.reproduction import pea_p885 as stack

ORDER = 46
"""States of the mirror's linear models."""
DELAYS = (0.0, 0.25, 0.5, 0.75)
"""Candidates in samples; the fifth realization chooses among them."""
MODES = {"none": (), "middle": mirror.LEVELS[1:2], "all": mirror.LEVELS}
"""Levels (mV) whose model loses each of its modes."""
LOST_GAIN = 0.05
LEAST_SHARE = 1.0
"""Energy of a deleted mode, relative to the residual of the whole model, above which its loss is diagnosed."""
FEW_OPERATORS = 3
"""Operators of the stack's crippled model: the smallest number that can be identified."""
CLEAN_ROWS, STRETCH = 7200, 1800
"""Rows of the second file, and of a record of it, on which the stack's whole model states its error."""
TITLE = "Measured, an effect withheld"
PLANTS = ("stack", "mirror")
NOTHING = "nothing"
"""Of a case whose model is whole."""


@dataclass(frozen=True)
class Withheld:
    """A measured case with one element of its model withheld.

    Parameters
    ----------
    plant
        The measured plant.
    element
        The element withheld.
    right
        Names of effects that are right for it.
    model
        The model without it.
    record
        The record to diagnose.
    warm_up
        Time that is not compared, s.
    floor
        Residual of the whole model on this record, rms in the measurement unit.
    """

    plant: str
    element: str
    right: tuple[str, ...]
    model: Model
    record: Record
    warm_up: float
    floor: float

    def digest(self) -> str:
        """SHA-256 of all that is diagnosed."""
        signals = (self.record.signals[name] for name in sorted(self.record.signals))
        head = json.dumps([model_to_document(self.model), self.warm_up])
        return hashlib.sha256(head.encode() + b"".join(s.time.tobytes() + s.values.tobytes() for s in signals)).hexdigest()


def run(
    out: str,
    page: str | None = None,
    modes: str = "all",
    note: Callable[[str], None] = print,
    plants: Sequence[str] | None = None,
    levels: Sequence[int] | None = None,
) -> Table:
    """Diagnose every case.

    Parameters
    ----------
    out
        Folder of the reports. A case whose report is there already is not diagnosed again: a run goes on where it stopped.
    page
        Page to write.
    modes
        One of `MODES`.
    note
        Called with every line of progress.
    plants
        Of `PLANTS`; all unless given.
    levels
        Levels (mV) whose models of the mirror are diagnosed; all unless given.

    Returns
    -------
    Table
        The figures.

    Raises
    ------
    InputError
        The measurements are absent, or there is no such plant or level.
    """
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
    for case, report in zip(cases, map_forked(lambda i: report_on(cases[i], folder), len(cases)), strict=True):
        rows.append((case, report))
        add(table, case, report)
        note(f"{case.plant}, without {case.element}: {sentence(report)}")
    add_summary(table, rows)
    if page is not None:
        write_page(Path(page), rows, modes, plants or PLANTS, levels or mirror.LEVELS)
    return table


def report_on(case: Withheld, folder: Path) -> dict[str, Any]:
    """Return the report on a case, from the folder where it is of this model and record, otherwise diagnosed now.

    Parameters
    ----------
    case
        The case.
    folder
        Folder of the reports.

    Returns
    -------
    dict[str, Any]
        The report.
    """
    path = folder / (re.sub(r"[^a-z0-9]+", "_", f"{case.plant} {case.element}".lower()).strip("_") + ".json")
    digest = case.digest()
    if path.exists():
        kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if kept["case"] == digest:
            return kept
    begin = time.monotonic()
    report = {**diagnosed([case.record], case.model, warm_up=case.warm_up)[0], "case": digest}
    write_json(path, {**report, "seconds": time.monotonic() - begin})
    return report


def add(table: Table, case: Withheld, report: dict[str, Any]) -> None:
    """Add the figures of one case.

    Parameters
    ----------
    table
        Table to add to.
    case
        The case.
    report
        Report on it.
    """
    table.add(TITLE, case.plant, f"without {case.element}", "gap_rms", report["gap"]["unit"], report["gap"]["rms"])
    table.add(TITLE, case.plant, f"without {case.element}", "whole_model_rms", report["gap"]["unit"], case.floor)
    table.add(TITLE, case.plant, f"without {case.element}", "named", "", float(named_right(case, report)))
    table.add(TITLE, case.plant, f"without {case.element}", "shrink", "", best_shrink(report))
    table.add(TITLE, case.plant, f"without {case.element}", "unexplained", "", float(report["unexplained_share"] or 0.0))


def is_solved(case: Withheld, report: dict[str, Any]) -> bool:
    """Report whether a case has the right verdict: no gap of a whole model, else the withheld element first, and an explanation.

    Parameters
    ----------
    case
        The case.
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    if case.element == NOTHING:
        return bool(report["verdict"] == "no_gap")
    return named_right(case, report) and report["verdict"] in ("effect", "parameters")


def named_right(case: Withheld, report: dict[str, Any]) -> bool:
    """Report whether the first name given is the withheld element, or one that the data cannot separate from it.

    Parameters
    ----------
    case
        The case.
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    return bool(report["effects"]) and report["effects"][0]["name"] in case.right


def best_shrink(report: dict[str, Any]) -> float:
    """Largest reduction of the gap's energy above the noise by a named effect on held-out blocks, coefficients fitted.

    Parameters
    ----------
    report
        Report on a case.

    Returns
    -------
    float
        Fraction of the energy; 0 without effects.
    """
    return max((effect["shrink_reidentified"] or 0.0 for effect in report["effects"]), default=0.0)


def add_summary(table: Table, rows: Sequence[tuple[Withheld, dict[str, Any]]]) -> None:
    """Add the fraction of cases in which the withheld element was the first name, with their number.

    Parameters
    ----------
    table
        Table to add to.
    rows
        Cases with their reports.
    """
    from hyst_control.blind_test.scores import wilson

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


def mirror_cases(
    modes: Sequence[int], note: Callable[[str], None] = print, of: Sequence[int] = mirror.LEVELS
) -> Iterator[Withheld]:
    """Construct the crippled models of the mirror, and every level's model against a higher level.

    Parameters
    ----------
    modes
        Levels (mV) whose model loses each of its modes in turn.
    note
        Called with every line of progress.
    of
        Levels (mV) whose models are diagnosed.

    Yields
    ------
    Withheld
        The cases.
    """
    levels = mirror.LEVELS
    measured = dict(zip(mirror.LEVELS, mirror.load_levels(), strict=True))
    middle = measured[mirror.LEVELS[1]]
    fits = list(map_forked(lambda i: fit(middle, DELAYS[i]), len(DELAYS)))
    delay = DELAYS[int(np.argmin([found.held_out for found in fits]))]
    whole = dict(zip(levels, map_forked(lambda i: fit(measured[levels[i]], delay), len(levels)), strict=True))
    note(
        f"mirror: input delay of {delay:g} samples, errors on the fifth realization "
        + ", ".join(f"{100 * found.held_out:.2f} % ({late:g})" for late, found in zip(DELAYS, fits, strict=True))
    )
    for level, found in whole.items():
        if level not in of:
            continue
        data = measured[level]
        bare = mirror.model_of(found.model, f"fsm_{level}mV", float(np.abs(data.command).max()))
        model = replace(bare, discrepancy=own_error(bare, data, mirror.SELECT[0]))
        record, warm_up = record_of(data, mirror.TEST[0]), mirror.PERIOD * mirror.SAMPLE_TIME
        floor = float(np.sqrt(np.mean(errors(model, data, mirror.TEST[0]) ** 2)))
        yield Withheld(f"mirror, {level} mV", NOTHING, (), model, record, warm_up, floor)
        for element, right, crippled in models_without_elements(model, level in modes, data, floor):
            yield Withheld(f"mirror, {level} mV", element, right, crippled, record, warm_up, floor)
        for other in (other for other in mirror.LEVELS if other > level):
            higher = record_of(measured[other], mirror.TEST[0])
            least = float(
                np.sqrt(np.mean(errors(mirror.model_of(whole[other].model, "", 1.0), measured[other], mirror.TEST[0]) ** 2))
            )
            yield Withheld(
                f"mirror, {level} mV model on {other} mV", "amplitude", ("softening_modes",), model, higher, warm_up, least
            )


def fit(level: mirror.Level, delay: float) -> Candidate:
    """Fit the linear model of a level, with its relative error on the fifth realization.

    Parameters
    ----------
    level
        Measurements at one level.
    delay
        Input delay, samples.

    Returns
    -------
    Candidate
        The model.
    """
    data = [level.spectra(mirror.FIT)]
    found = refined(data, subspace(data, [ORDER], np.full(3, delay), "zoh")[0], True, False, 25)
    return replace(found, held_out=error_of(found.model, [level.spectra(mirror.SELECT)]))


def errors(model: Model, level: mirror.Level, realization: int) -> Array:
    """Rms errors of a model on a realization, both periods.

    Parameters
    ----------
    model
        The model.
    level
        Measurements at one level.
    realization
        Index of the realization.

    Returns
    -------
    Array
        Errors (3,) in the measurement unit.
    """
    error: Array = np.sqrt(np.mean(np.concatenate(residuals(model, level, realization)) ** 2, axis=0))
    return error


def residuals(model: Model, level: mirror.Level, realization: int) -> list[Array]:
    """Compute measured minus simulated of a realization, in the steady state.

    Parameters
    ----------
    model
        The model.
    level
        Measurements at one level.
    realization
        Index of the realization.

    Returns
    -------
    list of Array
        (8192, 3) in the measurement unit, by period.
    """
    simulated = mirror.steady_state(model, level.command[:, :, [realization]].mean(axis=3))[:, :, 0]
    return list((level.measurement[:, :, realization] - simulated[..., None]).transpose(2, 0, 1))


def own_error(model: Model, level: mirror.Level, realization: int) -> dict[str, Any]:
    """Describe the error of a model on a realization that it was not fitted on, as `hyst identify` does.

    Parameters
    ----------
    model
        The model.
    level
        Measurements at one level.
    realization
        Index of the realization.

    Returns
    -------
    dict
        See `Model.discrepancy`.
    """
    commands = list(level.command[:, :, realization].transpose(2, 0, 1))
    return discrepancy_of(commands, residuals(model, level, realization), mirror.SAMPLE_TIME)


def record_of(level: mirror.Level, realization: int) -> Record:
    """Join both periods of a realization; the first brings the simulation into its steady state.

    Parameters
    ----------
    level
        Measurements at one level.
    realization
        Index of the realization.

    Returns
    -------
    Record
        The record.
    """
    command, measurement = (
        part[:, :, realization].transpose(2, 0, 1).reshape(-1, 3) for part in (level.command, level.measurement)
    )
    time = mirror.SAMPLE_TIME * np.arange(len(command), dtype=np.float64)
    return Record(
        {"command": Signal(time, command, mirror.AXES, "V"), "measurement": Signal(time, measurement, mirror.AXES, "um")},
        f"{level.name}, realization {realization + 1}",
    )


def models_without_elements(
    model: Model, modes: bool, level: mirror.Level, floor: float
) -> Iterator[tuple[str, tuple[str, ...], Model]]:
    """Remove one element of a model after the other.

    Parameters
    ----------
    model
        The whole model.
    modes
        Remove also each mode.
    level
        Measurements at one level.
    floor
        Residual of the whole model, rms in the measurement unit.

    Yields
    ------
    tuple[str, tuple[str, ...], Model]
        The element, the effects that are right for it, and the model without it.
    """
    *before, whole = model.chain.stages
    assert isinstance(whole, StateSpace)
    if any(isinstance(stage, Delay) for stage in before):
        yield "input delay", ("delay", "sensor_lowpass", "amplifier_lowpass", "dac_hold"), with_stages(model, whole)
    yield "coupling", ("cross_coupling",), with_stages(model, *before, uncoupled(whole))
    kept = 1.0 - LOST_GAIN
    yield (
        f"{100 * LOST_GAIN:g} % of its gain",
        ("gain", "hysteresis_width"),
        with_stages(model, *before, replace(whole, C=frozen(kept * np.array(whole.C)), D=frozen(kept * np.array(whole.D)))),
    )
    if not modes:
        return
    simulated = mirror.steady_state(model, level.command[:, :, [mirror.TEST[0]]].mean(axis=3))
    for block, frequency in oscillating(whole):
        crippled = with_stages(model, *before, without_states(whole, block))
        lost = mirror.steady_state(crippled, level.command[:, :, [mirror.TEST[0]]].mean(axis=3)) - simulated
        if np.mean(lost**2) > LEAST_SHARE * floor**2:
            yield f"mode at {frequency:.0f} Hz", ("resonance",), crippled


def with_stages(model: Model, *stages: Stage) -> Model:
    """Replace the stages of a model.

    Parameters
    ----------
    model
        The model.
    *stages
        Its new stages.

    Returns
    -------
    Model
        The new model.
    """
    return replace(model, chain=Chain(tuple(stages)))


def uncoupled(whole: StateSpace) -> StateSpace:
    """Remove the coupling: every axis is driven by its own input alone.

    Parameters
    ----------
    whole
        The system.

    Returns
    -------
    StateSpace
        The system without coupling.
    """
    a, b, c, d = (np.array(getattr(whole, part), dtype=float) for part in "ABCD")
    axes = range(len(d))
    return StateSpace(
        frozen(block_diag(*(a for _ in axes))),
        frozen(block_diag(*(b[:, [i]] for i in axes))),
        frozen(block_diag(*(c[[i]] for i in axes))),
        frozen(np.diag(np.diag(d))),
    )


def oscillating(whole: StateSpace) -> Iterator[tuple[slice, float]]:
    """Find the oscillating modes of a block-diagonal system below the band's end.

    Parameters
    ----------
    whole
        The system.

    Yields
    ------
    tuple[slice, float]
        States of a mode, and its frequency in Hz.
    """
    a = np.array(whole.A, dtype=float)
    row = 0
    while row < len(a):
        size = 2 if row + 1 < len(a) and a[row, row + 1] else 1
        if size == 2:
            frequency = float(np.abs(np.linalg.eigvals(a[row : row + 2, row : row + 2])[0])) / (2 * np.pi)
            if frequency < mirror.BANDS[-1] - 200.0:
                yield slice(row, row + 2), frequency
        row += size


def without_states(whole: StateSpace, block: slice) -> StateSpace:
    """Remove some states of a system.

    Parameters
    ----------
    whole
        The system.
    block
        The states.

    Returns
    -------
    StateSpace
        The system without them.
    """
    a, b, c = (np.array(getattr(whole, part), dtype=float) for part in "ABC")
    gone = np.arange(block.start, block.stop)
    kept = np.delete(np.delete(a, gone, axis=0), gone, axis=1)
    return replace(whole, A=frozen(kept), B=frozen(np.delete(b, gone, axis=0)), C=frozen(np.delete(c, gone, axis=1)))


def stack_cases() -> Iterator[Withheld]:
    """The stack's models without hysteresis and with too few operators, against the nested loops of the other file."""
    full, nested = stack.load()
    cycle = stack.cycles(full)[0]
    rows = stack.SCORED["rows 7950-14150"]
    whole = identify([cycle], "pi", operators=stack.OPERATORS, nuisance="offset").model
    # Clean records that nothing was fitted to and nothing is diagnosed on: full cycles, and stretches of growing and shrinking loops.
    stretches = [nested.rows(begin, begin + STRETCH) for begin in range(0, CLEAN_ROWS - STRETCH + 1, STRETCH)]
    own = discrepancy(whole, [*stack.cycles(full)[1:3], *stretches])
    few = identify([cycle], "pi", operators=FEW_OPERATORS, nuisance="offset").model
    part = nested.rows(0, rows.stop)
    for element, model in (
        (NOTHING, whole),
        ("hysteresis", without_memory(few, cycle)),
        (f"all but {FEW_OPERATORS} of {stack.OPERATORS} operators", few),
    ):
        # The sensor's zero differs between the files.
        zero = float(np.mean((part.measurement - simulate(model, part.command))[rows]))
        time = stack.SAMPLE_TIME * np.arange(len(part.command), dtype=np.float64)
        record = Record(
            {
                "command": Signal(time, part.command, ("x",), "V"),
                "measurement": Signal(time, part.measurement - zero, ("x",), "um"),
            },
            nested.name,
        )
        left = part.measurement[rows, 0] - simulate(whole, part.command)[rows, 0]
        right = () if model is whole else ("hysteresis_width", "hysteresis_shape", "backlash", "hysteresis_rate")
        yield Withheld(
            "stack", element, right, replace(model, discrepancy=own), record, rows.start * stack.SAMPLE_TIME, float(np.std(left))
        )


def without_memory(model: Model, cycle: Dataset) -> Model:
    """Replace the operators by a static gain: the slope of the cycle's chord.

    Parameters
    ----------
    model
        The model.
    cycle
        Record of one cycle.

    Returns
    -------
    Model
        The model without hysteresis.
    """
    slope = float(np.polyfit(cycle.command[:, 0], cycle.measurement[:, 0], 1)[0])
    return with_stages(model, TransferFunction((slope,), (1.0,)))


def write_page(
    path: Path,
    rows: Sequence[tuple[Withheld, dict[str, Any]]],
    modes: str,
    plants: Sequence[str] = PLANTS,
    levels: Sequence[int] = mirror.LEVELS,
) -> None:
    """Write docs/blind-test-measured.md.

    Parameters
    ----------
    path
        File to write.
    rows
        Cases with their reports.
    modes
        One of `MODES`.
    plants, levels
        That were diagnosed.
    """
    given = "" if tuple(plants) == PLANTS else f" --plants {' '.join(plants)}"
    given += "" if tuple(levels) == tuple(mirror.LEVELS) else f" --levels {' '.join(map(str, levels))}"
    lost = {
        "none": "leaves out the cases that lose one mode",
        "middle": "has the cases that lose one mode at the middle level only",
    }
    lines = [
        "# The diagnosis on measurements, an effect withheld",
        "",
        f"Generated by `hyst blind-test --measured --modes {modes}{given} --page`"
        + (f", which {lost[modes]}." if modes in lost else "."),
        "",
        *(line.strip() for line in (__doc__ or "").strip().splitlines()),
        "",
        "Shrink: share of the gap's energy above the noise that the named effects take off on blocks that neither chose nor fitted "
        "them. The mirror's states are those of the model itself; nothing was fitted to the realization that is diagnosed. Right: the "
        "withheld element is named first, with the verdict `effect` or `parameters` (first: with another verdict), or no gap is "
        "found where nothing is withheld.",
        "",
        "| measured plant | withheld | gap, rms | whole model, rms | verdict | named | right | shrink | unexplained | in words |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case, report in rows:
        names = ", ".join(
            effect["name"] + (f" ({', '.join(effect['axis'])})" if effect["axis"] else "") for effect in report["effects"]
        )
        right = "yes" if is_solved(case, report) else "first" if named_right(case, report) else "no"
        lines.append(
            f"| {case.plant} | {case.element} | {report['gap']['rms']:.3g} {report['gap']['unit']} | {case.floor:.3g} | "
            f"{report['verdict']} | {names} | {right} | {best_shrink(report):.2f} | {report['unexplained_share'] or 0:.2f} | "
            f"{sentence(report)} |"
        )
    scored = [(case, report) for case, report in rows if case.right]
    whole = [(case, report) for case, report in rows if case.element == NOTHING]
    lines += [
        "",
        f"Named first: {sum(named_right(*row) for row in scored)} of {len(scored)}, of these "
        f"{sum(is_solved(*row) for row in scored)} with the verdict `effect` or `parameters`. "
        f"No gap of a whole model: {sum(is_solved(*row) for row in whole)} of {len(whole)}.",
    ]
    write_text(path, "\n".join(lines) + "\n")
