"""Measured cases with one element of their model withheld: crippled models of the mirror and of the stack, and their records."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evaluation.blind_test.mirror_models import (
    DELAYS,
    errors,
    fit,
    models_without_elements,
    own_error,
    record_of,
    with_stages,
)
from evaluation.reproduction import fsm_cubespec_records as mirror
from evaluation.reproduction import pea_p885 as stack
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.identify import identify
from hyst_control.identify.data.dataset import Dataset
from hyst_control.identify.workflow import discrepancy
from hyst_control.model_file import Model, model_to_document, simulate
from hyst_control.parallel import map_forked
from hyst_control.records.record import Record, Signal

FEW_OPERATORS = 3
"""Operators of the stack's crippled model: the smallest number that can be identified."""
CLEAN_ROWS, STRETCH = 7200, 1800
"""Rows of the second file, and of a record of it, on which the stack's whole model states its error."""
PLANTS = ("stack", "mirror")
NOTHING = "nothing"
"""Of a case whose model is whole."""


@dataclass(frozen=True)
class Withheld:
    """A measured case with one element of its model withheld."""

    plant: str  # The measured plant
    element: str  # The element withheld
    right: tuple[str, ...]  # Names of effects that are right for it
    model: Model  # The model without it
    record: Record  # The record to diagnose
    warm_up: float  # Time that is not compared, s
    floor: float  # Residual of the whole model on this record, rms in the measurement unit

    def digest(self) -> str:
        """SHA-256 of all that is diagnosed."""
        signals = (self.record.signals[name] for name in sorted(self.record.signals))
        head = json.dumps([model_to_document(self.model), self.warm_up])
        return hashlib.sha256(head.encode() + b"".join(s.time.tobytes() + s.values.tobytes() for s in signals)).hexdigest()


def mirror_cases(
    modes: Sequence[int], note: Callable[[str], None] = print, of: Sequence[int] = mirror.LEVELS
) -> Iterator[Withheld]:
    """Construct the crippled models of the mirror, and every level's model against a higher level."""
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
    """Replace the operators by a static gain: the slope of the cycle's chord."""
    slope = float(np.polyfit(cycle.command[:, 0], cycle.measurement[:, 0], 1)[0])
    return with_stages(model, TransferFunction((slope,), (1.0,)))
