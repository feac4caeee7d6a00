"""Converters that round down, of few steps or many, on plants whose coefficients are off within their tolerance."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.blind_test.nominal_models import nominal
from evaluation.blind_test.plant_setups import SETUPS, scatter
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.decide.record_findings import detected
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.record_checks.summary import lattice_of, record_evidence
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.diagnose.run.prepare import without_truncation
from hyst_control.diagnose.search.fit import Linearised
from hyst_control.effects.effect import RecordCheck
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_plant_sim.physics import load_plant

PLANT = "pea_published"
SETUP = SETUPS[PLANT]
NOISE = 3e-3


def rounded(seed: int, noises: float, down: bool) -> tuple[Record, float]:
    """A diagnostic record, measured in steps of so many noises."""
    low, high = SETUP.command
    command = build({"signal": "diagnostic", "lowest": low, "highest": high, "duration": 0.7}, SETUP.sample_time, 1)
    step = noises * NOISE * SETUP.stroke
    effect = {"name": "quantization", "step": step, "rounding": int(down)}
    plant = load_plant(
        {"plant": PLANT, "rating": [low, high], "effects": [effect]},
        seed=seed,
        sample_time=SETUP.sample_time,
        noise=NOISE * SETUP.stroke,
        **scatter(PLANT, seed, 0.01),
    )
    measured = np.concatenate([plant.reset(command[0])[None], plant.step(command)[:-1]])
    time = SETUP.sample_time * np.arange(len(command))
    return Record({"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, measured, ("x",), "um")}, "r"), step


@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("seed, noises", [(0, 12.0), (3, 12.0), (4, 6.0)])
def test_a_half_step_is_told_beside_scattered_coefficients(seed, noises, down):
    """The constant that fits best beside coefficients 1 % off is 0.38 to 0.58 steps: the half step of the converter, and no offset."""
    record, step = rounded(seed, noises, down)
    problem, _ = problem_of([record], nominal(PLANT, NOISE))
    seen = record_evidence(problem, problem.rows(problem.measured() - problem.simulate(problem.model.chain.stages)))
    findings = detected(seen, frozenset(RecordCheck), CONFIGURATION.policy)
    assert [finding.check for finding in findings] == [RecordCheck.VALUE_LATTICE]
    shifted = without_truncation(Linearised(problem, scatter_of(problem.model)), findings, CONFIGURATION)
    shift = shifted.pieces[0].measurement - problem.pieces[0].measurement
    np.testing.assert_allclose(shift, 0.5 * step if down else 0.0, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("levels", [2, 3, 40])
def test_a_lattice_has_as_few_values_as_there_are(levels):
    """A sine in steps of half its range is as much on a lattice as one in fortieths."""
    sine = 0.5 + 0.5 * np.sin(np.linspace(0.0, 60.0, 6000))
    assert lattice_of(np.rint((levels - 1) * sine) * 0.3) == pytest.approx(0.3)
