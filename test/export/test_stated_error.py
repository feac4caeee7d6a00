"""The error that a model states of itself in C: that of `identify.learned_discrepancy`, late by what its rate needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exported_folder import compared

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.chain.command_features import play
from hyst_control.chain.memoryless import Gain
from hyst_control.cli import main
from hyst_control.export.compiled import CompiledProgram
from hyst_control.export.programs import stated_error
from hyst_control.export.stated_error import StatedError
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy, discrepancy_of
from hyst_control.model_file import load_model, save_model

SAMPLE_TIME = 1e-3


def records() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Commands of one axis at several rates and ranges, and an error that is hysteretic and rate dependent."""
    time = np.arange(3000) * SAMPLE_TIME
    commands = [
        50.0 + size * np.sin(2 * np.pi * rate * time) * np.cos(0.7 * time) for size, rate in ((40.0, 1.0), (20.0, 2.0), (45.0, 4.0))
    ]
    errors = [0.02 * play(u, 10.0) + 1e-5 * np.gradient(u, SAMPLE_TIME) for u in commands]
    random = np.random.default_rng(0)
    return [u[:, None] for u in commands], [(e + random.normal(0.0, 0.02, e.shape))[:, None] for e in errors]


@pytest.fixture(scope="module")
def model():
    stated = discrepancy_of(*records(), SAMPLE_TIME)
    assert stated["learned"][0] is not None
    named = load_model(config_path("models/pea_hampi.yaml"))
    return replace(named.with_stages((Gain(0.1),)), sample_time=SAMPLE_TIME, discrepancy=stated)


def test_it_is_the_learned_error_late_by_what_the_rate_needs(model):
    learned = LearnedDiscrepancy.from_document(model.discrepancy["learned"][0])
    command = np.ascontiguousarray(records()[0][1])
    running = StatedError(model, SAMPLE_TIME)
    running.settle(command[0])
    found = running.process(command)
    rows = learned.features.rows(command[:, 0], SAMPLE_TIME)
    still = learned.features.rows(np.full(3, command[0, 0]), SAMPLE_TIME)[0]
    expected = (rows - still) @ learned.mean
    deviation = np.sqrt(learned.rest**2 + np.sum(((rows - still) @ learned.factor) ** 2, axis=1))
    late = running.late
    assert late > 0
    np.testing.assert_allclose(found[late:, 0], expected[:-late], atol=1e-12)
    np.testing.assert_allclose(found[late:, 1], deviation[:-late], rtol=1e-10)
    again = StatedError(model, SAMPLE_TIME)
    again.settle(command[0])
    np.testing.assert_array_equal(np.concatenate([again.process(command[:7]), again.process(command[7:])]), found)


def test_c_and_python_agree_to_the_last_bit(model, tmp_path):
    exported = stated_error(model)
    c, python = CompiledProgram(exported.program), exported.python
    random = np.random.default_rng(5)
    command = 50.0 + np.cumsum(random.normal(0.0, 1.0, (3000, 1)), axis=0)
    command[1000:1100] = 1e6
    command[2500] = np.nan
    np.testing.assert_array_equal(c.settle(command[0]), python.settle(command[0]))
    expected = python.process(command)
    first = c.process(command[:800])
    saved = c.state.copy()
    c.settle(command[5])
    c.state[:] = saved
    np.testing.assert_array_equal(np.concatenate([first, c.process(command[800:])]), expected)
    save_model(model, tmp_path / "model.yaml")
    assert main(["export", str(tmp_path / "model.yaml"), "--discrepancy", "--output", str(tmp_path / "out")]) == 0
    compared(tmp_path / "out")


def test_without_learned_features_the_stated_rms_stands(model):
    alone = replace(model, discrepancy={"version": 1, "rms": [0.3]})
    running = StatedError(alone, SAMPLE_TIME)
    running.settle(np.zeros(1))
    assert running.late == 0
    np.testing.assert_array_equal(running.process(records()[0][0]), np.tile([0.0, 0.3], (3000, 1)))
    c = CompiledProgram(stated_error(alone).program)
    c.settle(np.zeros(1))
    np.testing.assert_array_equal(c.process(records()[0][0]), np.tile([0.0, 0.3], (3000, 1)))


def test_a_model_that_states_no_error_is_refused(model):
    with pytest.raises(InputError, match="discrepancy: the model states no error of its own: identify it with hyst identify"):
        stated_error(replace(model, discrepancy={}))
