"""Withheld cases: measured records, and models of their machine that lost one element, or never had it.

The mirror (`fsm_cubespec`): a linear model per level, fitted on realizations 1-4, its input delay chosen on the fifth, loses its delay, the
coupling of its axes, 5 % of its gain, and each mode in turn; the sixth realization is diagnosed. The error of the whole model on the fifth
is what it states of itself. Then the true unknown: a level's model against the records of a higher one. The stack (`pea_p885`): a model
without hysteresis, and one with too few operators, against the nested loops of another file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from evaluation.blind_test.case import Case, Label, Made, plain_record
from evaluation.blind_test.mirror_models import (
    DELAYS,
    MODE,
    fit,
    models_without_elements,
    own_error,
    record_of,
    rms_error,
    with_stages,
)
from evaluation.reproduction import fsm_cubespec_records as mirror
from evaluation.reproduction import pea_p885 as stack
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.identify import identify
from hyst_control.identify.data.dataset import Dataset
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.workflow import discrepancy
from hyst_control.model_file import Model, simulate
from hyst_control.parallel import map_forked
from hyst_control.records.record import Record

FEW_OPERATORS = 3
"""Operators of the stack's crippled model: the smallest number that can be identified."""
CLEAN_ROWS, STRETCH = 7200, 1800
"""Rows of the second file, and of a record of it, on which the stack's whole model states its error."""
PLANTS = ("stack", "mirror")
LEVELS = mirror.LEVELS
MODES = {"none": (), "middle": LEVELS[1:2], "all": LEVELS}
"""Levels (mV) whose model loses each of its modes."""
NOTHING = "nothing"
"""Withheld where the model is whole."""
HYSTERESIS = ("hysteresis_width", "hysteresis_shape", "backlash", "hysteresis_rate")


@dataclass(frozen=True)
class Withheld:
    """A measured record and a model that lacks an element of its machine."""

    right: tuple[str, ...]  # Names of effects that are right for the element; none of a whole model
    model: Model  # The model without it
    record: Record  # The record to diagnose
    warm_up: float  # Time that is not compared, s
    floor: float  # Residual of the whole model on this record, rms in the measurement unit


def drawn(plants: Sequence[str] = PLANTS, levels: Sequence[int] = LEVELS, modes: str = "all") -> list[Case]:
    """List the cases of some plants, and of the mirror's models of some levels."""
    elements = [("stack", element) for element in _stack()] if "stack" in plants else []
    for level in levels if "mirror" in plants else ():
        kept = [element for element in _mirror(level) if level in MODES[modes] or not element.startswith(MODE)]
        elements += [(f"mirror, {level} mV", element) for element in kept]
    return [
        Case(
            f"case_{index:04d}",
            plant,
            "none" if element == NOTHING else "single",
            "measured",
            0.0,
            0,
            () if element == NOTHING else ({"name": element},),
            source="withheld",
        )
        for index, (plant, element) in enumerate(elements)
    ]


def made(case: Case) -> Made:
    """Make a case: the record, and the model without the element."""
    element = case.names[0] if case.effects else NOTHING
    one = _stack()[element] if case.plant == "stack" else _mirror(int(case.plant.split()[1]))[element]
    command, measurement = (one.record.signal(name).values for name in ("command", "measurement"))
    counted = slice(round(one.warm_up / (one.model.sample_time or 1.0)), None)
    gap = float(np.sqrt(np.mean((measurement - simulate(one.model, command))[counted] ** 2)))
    label = Label(
        case.kind,
        case.names,
        gap,
        one.floor,
        accepted=(one.right,) if one.right else (),
        verdicts=("effect", "parameters") if one.right else ("no_gap",),
    )
    return Made(one.record, one.model, label, case.effects, warm_up=one.warm_up)


@cache
def _whole() -> dict[int, Candidate]:
    """The mirror's models by level, with the input delay that is best at the middle level."""
    measured = mirror.load_levels()
    fits = list(map_forked(lambda i: fit(measured[1], DELAYS[i]), len(DELAYS)))
    delay = DELAYS[int(np.argmin([found.held_out for found in fits]))]
    return dict(zip(LEVELS, map_forked(lambda i: fit(measured[i], delay), len(LEVELS)), strict=True))


@cache
def _mirror(level: int) -> dict[str, Withheld]:
    """The mirror's model of a level without each of its elements, and against every higher level."""
    measured, whole = dict(zip(LEVELS, mirror.load_levels(), strict=True)), _whole()
    data = measured[level]
    bare = mirror.model_of(whole[level].model, f"fsm_{level}mV", float(np.abs(data.command).max()))
    model = replace(bare, discrepancy=own_error(bare, data, mirror.SELECT[0]))
    record, warm_up = record_of(data, mirror.TEST[0]), mirror.PERIOD * mirror.SAMPLE_TIME
    floor = rms_error(model, data, mirror.TEST[0])
    found = {NOTHING: Withheld((), model, record, warm_up, floor)}
    for element, right, crippled in models_without_elements(model, data, floor):
        found[element] = Withheld(right, crippled, record, warm_up, floor)
    for other in (other for other in LEVELS if other > level):
        higher, least = record_of(measured[other], mirror.TEST[0]), mirror.model_of(whole[other].model, "", 1.0)
        floor = rms_error(least, measured[other], mirror.TEST[0])
        found[f"amplitude of {other} mV"] = Withheld(("softening_modes",), model, higher, warm_up, floor)
    return found


@cache
def _stack() -> dict[str, Withheld]:
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
    floor = float(np.std(part.measurement[rows, 0] - simulate(whole, part.command)[rows, 0]))

    def cases() -> Iterator[tuple[str, tuple[str, ...], Model]]:
        yield NOTHING, (), whole
        yield "hysteresis", HYSTERESIS, _without_memory(few, cycle)
        yield f"all but {FEW_OPERATORS} of {stack.OPERATORS} operators", HYSTERESIS, few

    found = {}
    for element, right, model in cases():
        zero = float(np.mean((part.measurement - simulate(model, part.command))[rows]))  # the sensor's differs between the files
        record = plain_record(part.command, part.measurement - zero, stack.SAMPLE_TIME, ("x",), nested.name)
        found[element] = Withheld(right, replace(model, discrepancy=own), record, rows.start * stack.SAMPLE_TIME, floor)
    return found


def _without_memory(model: Model, cycle: Dataset) -> Model:
    """Replace the operators by a static gain: the slope of the cycle's chord."""
    slope = float(np.polyfit(cycle.command[:, 0], cycle.measurement[:, 0], 1)[0])
    return replace(with_stages(model, TransferFunction((slope,), (1.0,))), uncertainty={})  # that was of the operators
