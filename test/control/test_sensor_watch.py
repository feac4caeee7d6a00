"""Watch over a sensor: what counts as frozen, by samples that are counted here by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.control.sensor_watch import FROZEN, OUT_OF_RANGE, MeasurementWatch


def faults(measured, commands, frozen_ticks=3, motion=1.0):
    """Fault of a single axis at every sample."""
    watch = MeasurementWatch(-5.0, 5.0, frozen_ticks, motion)
    return [(watch.check(np.array([value]), np.array([volts])) or ("",))[0] for value, volts in zip(measured, commands)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_constant_measurement_is_frozen_once_its_command_has_moved(sign):
    commands = sign * np.array([0.0, 0.5, 1.0, 1.5, 1.5, 1.5, 1.5])
    assert faults(np.full(7, 2.0), commands) == ["", "", "", "", "", FROZEN, FROZEN]  # moved by more than 1 V from the fourth on


def test_motion_is_the_range_whichever_way_the_command_went():
    assert faults(np.zeros(6), [0.0, 0.6, 0.0, -0.6, -0.6, -0.6]) == ["", "", "", "", "", FROZEN]


def test_a_stage_at_rest_may_measure_a_constant_for_ever():
    assert set(faults(np.full(1000, 2.0), np.linspace(0.0, 1.0, 1000))) == {""}


def test_a_value_that_changes_begins_anew():
    assert faults([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0], np.arange(7.0) * 2) == ["", "", "", "", "", "", FROZEN]


def test_never_frozen_and_out_of_range_on_either_side():
    assert set(faults(np.zeros(50), np.arange(50.0), frozen_ticks=0)) == {""}
    assert faults([5.0, 5.1, -5.0, -5.1, np.nan, 1.0], np.zeros(6)) == ["", OUT_OF_RANGE, "", OUT_OF_RANGE, OUT_OF_RANGE, ""]


def test_axes_are_watched_one_by_one_and_afresh_when_their_number_changes():
    watch = MeasurementWatch(-5.0, 5.0, 2, 1.0)
    for k in range(3):
        found = watch.check(np.array([1.0, k, 9.0]), np.full(3, 2.0 * k))
    assert found == (FROZEN, "", OUT_OF_RANGE)
    assert watch.check(np.array([1.0]), np.array([9.0])) == ()
