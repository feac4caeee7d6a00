# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`backend: c`: feedforward and feedback run the exported C, and a run equals the offline computation bit for bit."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from loop_case import assert_same_bits, offline, parameters, recorded
from test_lockstep import composed

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.pi import PI
from hyst_control.export.backend import CompiledPI
from hyst_control.export.compiled import COMPILERS, c_compiler

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason=f"no C compiler: none of {', '.join(COMPILERS)} is installed"
)


@pytest.mark.parametrize(
    "filters", [Filters(), Filters(1e-5, 3000.0, (1230.0,), (0.7,), (0.1,), 0.5, 900.0)], ids=["pi", "filters"]
)
def test_lockstep_in_c_equals_offline(filters, tmp_path, ros_context, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    backend = {"backend": "c"}
    composed(ros_context, parameters(tmp_path, 700, hampi_feedforward=backend, pi_feedback={**backend, **vars(filters)}))
    assert_same_bits(recorded(tmp_path / "bag"), offline(700, filters=filters))
    libraries = sorted(path.name.split("-")[0] for path in (tmp_path / "cache").rglob("*.so"))
    assert libraries == ["feedforward", "pi_feedback"]


@pytest.mark.parametrize("filters", [Filters(), Filters(1e-4, 3000.0, (800.0, 2500.0), (0.7,), (0.1,), 0.2, 900.0)])
def test_the_feedback_in_c_has_the_states_and_counts_of_the_python_one(filters, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    law = PI(0.5, 2000.0, 5e-5, 0.0, 20.0, 2e5, roll_off=400.0, filters=filters)
    python, c = law.start(2), CompiledPI(law, 2)
    random = np.random.default_rng(0)
    for turn in range(200):
        given = [random.normal(3.0, 2.0, (turn % 4 + 1, 2)) for _ in range(3)]
        given[2] *= 3.0
        for found, expected in zip(c.step(*given), python.step(*given)):
            np.testing.assert_array_equal(found, expected)
        assert c.saturated == python.saturated
        np.testing.assert_array_equal(c.command, python.command)
        if turn % 50 == 20:
            inputs = [part[0] for part in given]
            for running in (python, c):
                running.ramp(np.array([3.0, 4.0]), 1e4, 5)
                running.resume(running.command, inputs[0], inputs[1], inputs[2])
        if turn % 50 == 40:
            for running in (python, c):
                running.reset(None if turn < 100 else np.array([1.0, 2.0]))
    assert python.saturated


def test_a_missing_compiler_is_one_line_with_its_remedy():
    with pytest.raises(InputError, match="no C compiler: no-such-cc is not installed: install gcc, or take backend: python"):
        c_compiler("no-such-cc")
