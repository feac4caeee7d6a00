# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Withheld cases: measured records, and models of their machine that lost one element, or never had it.

The mirror: a linear model per level, fitted on realizations 1-4, states its error on the fifth and loses delay, coupling, 5 % of its gain
and each mode in turn; the sixth is diagnosed, then that of a higher level. The stack: models without hysteresis and with too few
operators.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from evaluation.blind_test.case import Case, Label, Made
from evaluation.blind_test.mirror_models import DELAYS, ORDER, models_without_elements, rms_error, stated_model
from evaluation.reproduction import fsm_cubespec_records as mirror
from evaluation.reproduction import pea_p885 as stack
from hyst_control.base.parallel import map_forked
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.identify import identify
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.workflow import discrepancy
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, sampled_record

FEW_OPERATORS = 3
"""Operators of the stack's crippled model: the smallest number that can be identified."""
CLEAN_ROWS, STRETCH = 7200, 1800
"""Rows of the second file, and of a record of it, on which the stack's whole model states its error."""
PLANTS = ("stack", "mirror")
LEVELS = mirror.LEVELS
NOTHING = "nothing"
"""Withheld where the model is whole."""
HYSTERESIS = ("hysteresis_width", "hysteresis_shape", "backlash", "hysteresis_rate")


def drawn(plants: Sequence[str] = PLANTS) -> list[Case]:
    """List the cases of some plants."""
    rows = [("stack", one) for one in _stack().values()] if "stack" in plants else []
    for level in LEVELS if "mirror" in plants else ():
        rows += [(f"mirror, {level} mV", one) for one in _mirror(level).values()]
    return [
        Case(f"case_{index:04d}", plant, one.label.kind, one.record.source, 0.0, 0, one.effects, source="withheld")
        for index, (plant, one) in enumerate(rows)
    ]


def made(case: Case) -> Made:
    """Make a case: the record, and the model without the element."""
    table = _stack() if case.plant == "stack" else _mirror(int(case.plant.split()[1]))
    return table[case.names[0] if case.effects else NOTHING]


def _without(element: str, right: tuple[str, ...], model: Model, record: Record, warm_up: float, floor: float) -> Made:
    """A record with a model that lacks an element, for which some names are right; `floor`: what the whole model leaves, rms."""
    command, measurement = (record.signal(name).values for name in ("command", "measurement"))
    counted = slice(round(warm_up / (model.sample_time or 1.0)), None)
    gap = float(np.sqrt(np.mean((measurement - simulate(model, command))[counted] ** 2)))
    if element == NOTHING:
        return Made(record, model, Label("none", (), gap, floor, verdicts=("no_gap",)), (), warm_up=warm_up)
    label = Label("single", (element,), gap, floor, accepted=(right,), verdicts=("effect", "parameters"))
    return Made(record, model, label, ({"name": element},), warm_up=warm_up)


@cache
def _whole() -> dict[int, Candidate]:
    """The mirror's models by level, with the input delay that is best at the middle level."""
    measured = mirror.load_levels()
    fits = list(map_forked(lambda i: mirror.fit_level(measured[1], ORDER, DELAYS[i]), len(DELAYS)))
    delay = DELAYS[int(np.argmin([found.held_out for found in fits]))]
    return dict(zip(LEVELS, map_forked(lambda i: mirror.fit_level(measured[i], ORDER, delay), len(LEVELS)), strict=True))


@cache
def _mirror(level: int) -> dict[str, Made]:
    """The mirror's model of a level without each of its elements, and against every higher level."""
    measured, whole = dict(zip(LEVELS, mirror.load_levels(), strict=True)), _whole()
    model = stated_model(whole[level], measured[level], mirror.SELECT[0], f"fsm_{level}mV")
    floor = rms_error(model, measured[level], mirror.TEST[0])
    found: list[tuple[str, tuple[str, ...], Model, int, float]] = [(NOTHING, (), model, level, floor)]
    for element, right, crippled in models_without_elements(model, measured[level], floor):
        found.append((element, right, crippled, level, floor))
    for other in (other for other in LEVELS if other > level):
        least = rms_error(mirror.model_of(whole[other].model, "", 1.0), measured[other], mirror.TEST[0])
        found.append((f"amplitude of {other} mV", ("softening_modes",), model, other, least))
    records, warm_up = {of: measured[of].record(mirror.TEST[0]) for of in LEVELS}, mirror.PERIOD * mirror.SAMPLE_TIME
    return {element: _without(element, right, model, records[of], warm_up, floor) for element, right, model, of, floor in found}


@cache
def _stack() -> dict[str, Made]:
    """The stack's models without hysteresis and with too few operators, against the nested loops of the other file."""
    full, nested = stack.load()
    cycle = stack.cycles(full)[0]
    rows = stack.SCORED["rows 7950-14150"]
    whole = identify([cycle], "pi", operators=stack.OPERATORS, nuisance="offset").model
    # Baseline records that nothing was fitted to and nothing is diagnosed on: full cycles, and stretches of growing and shrinking loops.
    stretches = [nested.rows(begin, begin + STRETCH) for begin in range(0, CLEAN_ROWS - STRETCH + 1, STRETCH)]
    own = discrepancy(whole, [*stack.cycles(full)[1:3], *stretches])
    few = identify([cycle], "pi", operators=FEW_OPERATORS, nuisance="offset").model
    part = nested.rows(0, rows.stop)
    floor = float(np.std(part.measurement[rows, 0] - simulate(whole, part.command)[rows, 0]))
    found = {}
    for element, right, model in (
        (NOTHING, (), whole),
        ("hysteresis", HYSTERESIS, _without_memory(few, cycle)),
        (f"all but {FEW_OPERATORS} of {stack.OPERATORS} operators", HYSTERESIS, few),
    ):
        zero = float(np.mean((part.measurement - simulate(model, part.command))[rows]))  # the sensor's differs between the files
        record = sampled_record(nested.name, part.command, part.measurement - zero, stack.SAMPLE_TIME, ("x",), "um")
        warm_up = rows.start * stack.SAMPLE_TIME
        found[element] = _without(element, right, replace(model, discrepancy=own), record, warm_up, floor)
    return found


def _without_memory(model: Model, cycle: Record) -> Model:
    """Replace the operators by a static gain: the slope of the cycle's chord."""
    slope = float(np.polyfit(cycle.command[:, 0], cycle.measurement[:, 0], 1)[0])
    return replace(model.with_stages([TransferFunction((slope,), (1.0,))]), uncertainty={})  # that was of the operators
