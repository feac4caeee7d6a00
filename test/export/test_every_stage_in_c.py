# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every registered stage in C, compiled here: the same bits as in Python in double, within 1e-5 of the range in float."""

from __future__ import annotations

import numpy as np
import pytest
from test_every_stage import CASES, SAMPLE_TIME, command, started

from hyst_control.base.errors import InputError
from hyst_control.chain import STAGES, Chain, Sampling
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.chain.hysteresis.madelung import CAPACITY
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.stage import Filter
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.effects.softening_modes import SofteningModes
from hyst_control.export.c_source import Program, Slot
from hyst_control.export.compiled import CompiledProgram
from hyst_control.model_file import Model

RANDOM = {"sensor_noise", "flicker_noise", "held_samples"}
"""Stages that draw random numbers: the only ones without C."""
RAILS = {"duhem": 1e3, "duhem_oscillator": 1e3, "bouc_wen": 1e3}
"""V, of stages that integrate differential equations: beyond, their integration overflows in Python as in C. 1e6 for the others."""
LATTICES = {"quantization": 2.5, "dac_hold": 0.5}
"""Stages with steps, where float may fall on the other side of one, and their greatest step."""
ROWS = 3000


def compiled(code: CCode, axes: int, real: str = "double") -> CompiledProgram:
    slots = tuple(Slot(f"axis_{i}", "") for i in range(axes))
    return CompiledProgram(Program("unit", code, axes, slots, slots, SAMPLE_TIME, ("of a test",), real))


def rough(seed: int, axes: int, rail: float = 1e6) -> np.ndarray:
    """A wandering command with plateaus, reversals at every row, long stays at far rails (V), and zeros."""
    u = command(seed, ROWS, axes)
    inward = np.concatenate([np.linspace(1.0, 0.1, 30), np.linspace(0.1, 1.0, 170)])
    u[400:600] = (50.0 + 40.0 * (-1.0) ** np.arange(200) * inward)[:, None]
    u[1000:1020], u[1020:1040] = -rail, rail
    u[1500:1510] = 0.0
    return u


@pytest.mark.parametrize("case", [case for case, (name, _) in CASES.items() if name not in RANDOM])
@pytest.mark.parametrize(("hold", "axes"), [("foh", 1), ("zoh", 3)])
def test_c_and_python_agree_to_the_last_bit(case, hold, axes):
    """Random signals, reversals, rails and NaN; in the middle the state is saved, overwritten and restored."""
    python = started(case, axes, hold)
    c = compiled(python.c_code(), axes)
    for seed, spoiled in ((1, None), (2, 700)):
        u = rough(seed, axes, RAILS.get(CASES[case][0], 1e6))
        if spoiled is not None:
            u[spoiled] = np.nan
        np.testing.assert_array_equal(c.settle(u[0]), python.settle(u[0]))
        expected = python.process(u)
        assert np.isfinite(expected if spoiled is None else expected[:spoiled]).all()
        first = c.process(u[:800])
        saved = c.state.copy()
        c.settle(u[5])
        c.state[:] = saved
        np.testing.assert_array_equal(np.concatenate([first, c.process(u[800:])]), expected)


def test_modes_with_factors_of_their_own_agree_to_the_last_bit():
    first, second = [1.0, 80.0, 4e6], [1.0, 300.0, 2e7]
    mechanics = TransferFunction(np.polyadd(np.multiply(4e6, second), np.multiply(1e7, first)), np.polymul(first, second))
    results = []
    for factors in ((1.0,), (2.0, 0.5)):
        stage = SofteningModes(0.03, 0.4, 2.0, softening_factors=factors, damping_factors=factors)
        python = Chain((mechanics, stage)).filter(Sampling(SAMPLE_TIME, 1, "zoh"))
        c, u = compiled(python.c_code(), 1), command(4, ROWS, 1)
        np.testing.assert_array_equal(c.settle(u[0]), python.settle(u[0]))
        results.append(python.process(u))
        np.testing.assert_array_equal(c.process(u), results[-1])
    assert np.abs(results[1] - results[0]).max() > 1e-3 * np.ptp(results[0])


@pytest.mark.parametrize("case", [case for case, (name, _) in CASES.items() if name not in RANDOM])
def test_float_is_within_1e_5_of_the_range(case):
    axes = 2
    python = started(case, axes, "zoh")
    c = compiled(python.c_code(), axes, "float")
    u = command(3, ROWS, axes).astype(np.float32).astype(float)
    python.settle(u[0])
    c.settle(u[0])
    expected, found = python.process(u), c.process(u)
    off = np.abs(found - expected) / np.ptp(expected, axis=0)
    beyond = off > 1e-5
    if CASES[case][0] in LATTICES:  # a value midway between two steps may go to either
        step = LATTICES[CASES[case][0]]
        assert np.abs(found - expected).max() <= 1.001 * step and beyond.mean() < 1e-2
    else:
        assert not beyond.any(), off.max()


@pytest.mark.parametrize("frequency", [1.0, 3.16, 10.0, 40.0])
def test_an_inverse_of_slow_dynamics_is_within_1e_5_in_float(frequency):
    """At 333 Hz: what is left of large parts that cancel would be their rounding."""
    w, units = 2.0 * np.pi * frequency, {"command": "V", "measurement": "um"}
    chain = Chain((PrandtlIshlinskii([0.0, 5.0, 20.0], [0.02, 0.01, 0.01]), TransferFunction([w**2], [1.0, 1.6 * w, w**2])))
    python = build_compensator(Model("slow", ("x",), units, 3e-3, chain), "hapi", limits=(0.0, 80.0))
    c = compiled(python.c_code(), 1, "float")
    time = 3e-3 * np.arange(ROWS)[:, None]
    u = (1.2 - np.cos(3.0 * time) - 0.2 * np.cos(17.0 * time)).astype(np.float32).astype(float)
    python.settle(u[0])
    c.settle(u[0])
    expected = python.process(u)
    assert np.abs(c.process(u) - expected).max() < 1e-5 * np.ptp(expected)


def test_a_wider_madelung_loop_has_the_same_bits_too():
    """Its mean curve is no stage of a model file: it is there only where a modifier takes it off."""
    width = STAGES["hysteresis_width"](width=[0.3, -0.2])
    for case in ("madelung", "madelung, knots"):
        name, make = CASES[case]
        python = Chain((STAGES[name](**make(2)), width)).filter(Sampling(SAMPLE_TIME, 2))
        c = compiled(python.c_code(), 2)
        u = rough(6, 2)
        np.testing.assert_array_equal(c.settle(u[0]), python.settle(u[0]))
        np.testing.assert_array_equal(c.process(u), python.process(u))


def test_every_stage_has_c_or_says_why_not():
    """A new stage brings its C (`Filter.c_code`), or draws random numbers."""
    for name in STAGES:
        case = started(name, 2, "zoh")
        if name in RANDOM:
            with pytest.raises(InputError, match="draws random numbers, which belong to a simulation: leave the stage out"):
                case.c_code()
        else:
            assert case.c_code().step


def test_a_filter_without_c_names_itself_and_the_remedy():
    class Odd(Filter):
        pass

    with pytest.raises(InputError, match=r"Odd: the stage brings no C \(Filter.c_code\): leave it out, or give it its C"):
        Odd().c_code()


@pytest.mark.parametrize(
    ("case", "loops"), [("madelung", 46), ("madelung", 90), ("madelung, bipolar", 48), ("madelung, bipolar", 90)]
)
def test_nested_loops_are_exact_as_deep_as_the_stack_and_counted_beyond(case, loops):
    """Loops within loops. Deeper than the C keeps, the outer ones stay what they are, and the way out of them is Python's again."""
    python = started(case, 1, "zoh")
    c = compiled(python.c_code(), 1)
    middle, size = (50.0, 45.0) if case == "madelung" else (20.0, 45.0)
    inward = middle + size * (-1.0) ** np.arange(loops) * np.linspace(1.0, 0.02, loops)
    outward = np.linspace(inward[-1], middle + 1.09 * size, 400)
    u = np.concatenate([[0.0], inward, outward])[:, None]
    python.settle(u[0])
    c.settle(u[0])
    expected, found = python.process(u), c.process(u)
    same = (found == expected)[:, 0]
    forgotten = int(c.state[-4:].view(np.int32)[0])
    if loops <= CAPACITY:
        assert same.all() and forgotten == 0
    else:
        assert same[:40].all() and not same.all() and forgotten >= (loops - CAPACITY) // 2
        assert np.abs(found - expected).max() < 0.005 * np.ptp(expected)
        assert same[-15:].all()  # beyond the outermost loop


@pytest.mark.parametrize("case", ["madelung", "madelung, bipolar"])
def test_the_state_of_two_axes_of_madelung_hysteresis_is_below_2_kib(case):
    assert compiled(started(case, 2, "zoh").c_code(), 2).state.nbytes <= 2048
