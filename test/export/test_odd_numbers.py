# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The exported C given numbers that nobody should send: NaN, infinities, denormals and absurd magnitudes, alone and among sound ones."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from exported_folder import compared
from test_every_stage import CASES, SAMPLE_TIME, command, started
from test_every_stage_in_c import RANDOM, compiled

from hyst_control.chain import STAGES, Sampling
from hyst_control.chain.c_code.c_code import parallel
from hyst_control.export.c_source import Program, Slot
from hyst_control.export.folder import write_folder
from hyst_control.export.programs import Exported

EXPORTED = [case for case, (name, _) in CASES.items() if name not in RANDOM]
LARGEST = {"transfer_function, coupled": 1e12}
"""V, where Python adds matrices' products in another order, which shows once a sum overflows. All of double for the others."""


def odd_rows(seed: int, sound: np.ndarray, largest: float) -> np.ndarray:
    """For a while the sound rows, for a while with one odd number among them, for a while nothing but odd ones."""
    random = np.random.default_rng(seed)
    rows, columns = sound.shape
    kinds = np.repeat(random.integers(0, 3, rows // 25 + 1), 25)[:rows, None]
    special = [0.0, -0.0, np.nan, 5e-324, -5e-324, largest, -largest, *([np.inf, -np.inf] if largest > 1e300 else [])]
    exponents = random.integers(-1074, int(np.log2(largest)), sound.shape)
    numbers = np.ldexp(random.choice([-1.0, 1.0], sound.shape), exponents)
    odd = np.where(random.random(sound.shape) < 0.5, random.choice(special, sound.shape), numbers)
    one = random.integers(0, columns, rows)[:, None] == np.arange(columns)
    return np.where((kinds == 2) | ((kinds == 1) & one), odd, sound)


@pytest.mark.parametrize("case", EXPORTED)
@pytest.mark.parametrize(("hold", "axes"), [("foh", 1), ("zoh", 3)])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_c_and_python_agree_on_odd_numbers_to_the_last_bit(case, hold, axes):
    python = started(case, axes, hold)
    c = compiled(python.c_code(), axes)
    for seed in range(2):
        u = odd_rows(seed, command(seed, 1500, axes), LARGEST.get(case, np.finfo(float).max))
        u[0] = 40.0
        np.testing.assert_array_equal(c.settle(u[0]), python.settle(u[0]))
        np.testing.assert_array_equal(c.process(u), python.process(u))


@pytest.mark.parametrize("inverse", [False, True])
def test_a_madelung_loop_follows_again_after_nan(inverse):
    """NaN comes out again and leaves nothing behind: the other rows are what they are without it."""
    stage = STAGES["madelung"](**{**CASES["madelung"][1](2), "inverse": inverse})
    running = stage.filter(Sampling(SAMPLE_TIME, 2))
    u = command(3, 1000, 2) / (100.0 if inverse else 1.0)
    running.settle(u[0])
    expected = running.process(u)
    spoiled = u.repeat(3, axis=0)
    spoiled[1::3], spoiled[2::3, 1] = np.nan, np.nan
    running.settle(u[0])
    found = running.process(spoiled)
    np.testing.assert_array_equal(found[::3], expected)
    assert np.isnan(found[1::3]).all() and np.isnan(found[2::3, 1]).all()
    np.testing.assert_array_equal(found[2::3, 0], expected[:, 0])


def test_no_stage_does_anything_undefined(tmp_path):
    """All stages beside each other in one program: compiled with sanitizers, and as from Python once they settle again.

    By clang where it is: the other tests compile each stage with gcc.
    """
    hold, axes = "zoh", 2
    running = [started(case, axes, hold) for case in EXPORTED]
    slots = tuple(Slot(f"x{i}", "V") for i in range(axes))
    program = Program("all", parallel([each.c_code() for each in running]), axes, slots, slots, SAMPLE_TIME, ())

    class Together:
        def settle(self, value):
            return sum(each.settle(value.copy()) for each in running)

        def process(self, block):
            return sum(each.process(block.copy()) for each in running)

    write_folder(Exported(program, Together(), np.tile([[0.0, 100.0]], (axes, 1))), tmp_path)
    compared(
        tmp_path,
        "STEPS=3000",
        f"COMPILERS={'clang' if shutil.which('clang') else 'gcc'}",
        "SANITIZERS=-O0 -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all",
        target="fuzz",
    )
