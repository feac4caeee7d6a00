# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of single effects end at their minimum: records of truth plants, which share no code with the models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evaluation.blind_test.plant_setups import scatter
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.run.diagnosis import with_clean
from hyst_control.diagnose.run.prepare import prepare
from hyst_control.diagnose.search import starts as candidate_fits
from hyst_control.diagnose.search.beam_search import search
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import fit
from hyst_control.diagnose.search.starts import begin
from test.diagnose.conftest import nominal, record_of


@pytest.mark.parametrize(("plant", "cutoff"), [("pea_published", 1071.0), ("fsm_published", 597.0)])
def test_a_second_order_low_pass_beside_a_large_gap(plant, cutoff):
    """A step in all coefficients leads astray: fits that begin there alone end at 3 to 70 times the noise."""
    record = record_of(plant, [{"name": "amplifier_lowpass", "cutoff": cutoff, "order": 2}])
    parts = with_clean([record], nominal(plant), 0.0, CONFIGURATION, ())[3]
    prepared = prepare(*parts[0][:2], (), CONFIGURATION)
    lowpasses = [member for member in prepared.members(False) if member.name == "amplifier_lowpass"]
    best = search(prepared.linearized, lowpasses, 10.0, prepared.floor, prepared.leaves).singles[0]
    values = best.candidate.members[0].values(best.solution.x)
    assert values["order"] == 2.0 and values["cutoff"] == pytest.approx(cutoff, rel=0.01)
    assert best.solution.residual @ best.solution.residual < 1.3 * len(best.solution.residual)


def test_a_second_order_low_pass_and_a_gain():
    """Beside the gain no fit of the low-pass alone comes near: it must not stop at the end of the range of its damping."""
    effects = [{"name": "gain", "gain": 0.16}, {"name": "amplifier_lowpass", "cutoff": 1071.0, "order": 2}]
    record = record_of("pea_published", effects, seed=0, duration=1.0, **scatter("pea_published", 0, 0.01))
    model = nominal("pea_published")
    model = replace(model, tolerance=dict.fromkeys(model.tolerance, 0.01))
    prepared = prepare(*with_clean([record], model, 0.0, CONFIGURATION, ())[3][0][:2], (), CONFIGURATION)
    members = [member for member in prepared.members(False) if member.name in ("amplifier_lowpass", "gain")]
    found = search(prepared.linearized, members, 10.0, prepared.floor, prepared.leaves)
    best = max((*found.singles, *found.combinations), key=lambda one: one.score)
    assert best.names == ("amplifier_lowpass", "gain")


def test_a_fit_that_stops_far_from_its_minimum_is_gone_on_with(monkeypatch):
    """Columns of the nominal coefficients may lead nowhere: a fit that was begun near the record is not given up for that."""
    record = record_of("pea_published", [{"name": "delay", "tau": 1e-4}], duration=0.5)
    problem, clean = with_clean([record], nominal("pea_published"), 0.0, CONFIGURATION, ())[3][0][:2]
    prepared = prepare(problem, clean, (), CONFIGURATION)
    members = [member for member in prepared.members(False) if member.name in ("delay", "gain")]

    def stopped(linearized, begun, rival):
        return fit(linearized, begun.candidate.unknowns(), 0.7 * begun.ends[0].x, rounds=0)

    monkeypatch.setattr("hyst_control.diagnose.search.beam_search.gone_on", stopped)
    best = search(prepared.linearized, members, 10.0, prepared.floor, prepared.leaves).singles[0]
    assert best.names == ("delay",)
    assert best.candidate.members[0].values(best.solution.x)["tau"] == pytest.approx(1e-4, rel=0.02)


def test_only_a_fit_that_promises_less_than_its_rival_is_stopped_on_its_way(monkeypatch):
    """One that promises more may still lie behind in its first steps, and must not be stopped there."""
    record = record_of("pea_published", [{"name": "delay", "tau": 1e-4}], duration=0.5)
    prepared = prepare(*with_clean([record], nominal("pea_published"), 0.0, CONFIGURATION, ())[3][0][:2], (), CONFIGURATION)
    delay = next(member for member in prepared.members(False) if member.name == "delay")
    begun = begin(prepared.linearized, [(Candidate((delay,)), delay.starts())], CONFIGURATION.search)[0]
    rivals: list[float] = []

    def told(*given, rival):
        rivals.append(rival)
        return fit(*given, rival=rival)

    monkeypatch.setattr(candidate_fits, "fit", told)
    for other in (1.01 * begun.misfit, 0.99 * begun.misfit):
        candidate_fits.gone_on(prepared.linearized, replace(begun, ends=begun.ends[:1]), other)
    assert rivals == [np.inf, 0.99 * begun.misfit]


@pytest.mark.parametrize(("frequency", "damping", "gain"), [(310.0, 0.02, 0.03), (1292.0, 0.05, -0.01), (4078.0, 0.013, 0.06)])
def test_a_scan_over_frequencies_keeps_those_next_to_the_mode(frequency, damping, gain):
    mode = {"name": "resonance", "frequency": frequency, "damping": damping, "gain": gain}
    record = record_of("pea_published", [mode])
    prepared = prepare(*with_clean([record], nominal("pea_published"), 0.0, CONFIGURATION, ())[3][0][:2], (), CONFIGURATION)
    member = next(member for member in prepared.members(False) if member.name == "resonance")
    unknowns = Candidate((member,)).unknowns()
    kept = candidate_fits.best_scaled(prepared.linearized, unknowns, member.starts(), 8)
    nearest = min(member.starts(), key=lambda start: abs(start[0] - np.log(frequency)))
    assert len(kept) == 8 and nearest[0] in [start[0] for start in kept]


def test_an_effect_that_is_hardly_there_is_not_beyond_its_range():
    """A low-pass as fast as the sampling shows is next to none; one as slow as the catalogue has may be slower yet."""
    record = record_of("pea_published", [])
    problem = with_clean([record], nominal("pea_published"), 0.0, CONFIGURATION, ())[3][0][0]
    members = {member.name: member for member in catalogue(problem, {})}
    for name, fast, slow in (("sensor_lowpass", False, True), ("slew_limit", False, True), ("creep", True, True)):
        lower, upper, centre = members[name].bounds()
        assert not members[name].is_at_bound(centre)
        assert [members[name].is_at_bound(end) for end in (upper, lower)] == [fast, slow]
