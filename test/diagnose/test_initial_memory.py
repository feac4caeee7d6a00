"""Initial memory of a session: a machine that comes from elsewhere differs until the command has met both its extremes."""

from __future__ import annotations

import numpy as np

from hyst_control.diagnose.initial_memory import left_of_memory
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.records.record import Record, Signal

RATE, SPAN = 2000.0, 100.0
TIME = np.arange(2400) / RATE
COMMAND = np.interp((TIME * 5.0 + 0.45) % 1.0, [0.0, 0.5, 1.0], [0.0, SPAN, 0.0])
"""A triangle that begins on its way up, near its upper end."""
FILLED = int(np.flatnonzero(COMMAND == COMMAND.min())[0])


def machine(before: tuple[float, ...], seed: int, gain: float = 1.0) -> np.ndarray:
    """Relays of Preisach's plane, which were led through the extremes `before` the record; a lag; noise. Of this test alone."""
    history = np.concatenate([np.interp(np.arange(0.0, len(before) - 1, 0.01), np.arange(len(before)), before), COMMAND])
    up, down = np.meshgrid(np.linspace(2.0, 98.0, 49), np.linspace(2.0, 98.0, 49))
    up, down = up[up >= down], down[up >= down]
    weight = np.exp(-(((up - down) / 40.0) ** 2))
    state, output = -np.ones(len(up)), np.empty(len(history))
    for row, u in enumerate(history):
        state[u >= up], state[u <= down] = 1.0, -1.0
        output[row] = weight @ state / weight.sum()
    return gain * 10.0 * output[-len(COMMAND) :] + 2e-3 * np.random.default_rng(seed).standard_normal(len(COMMAND))


def record(measurement: np.ndarray, source: str) -> Record:
    signals = {
        "command": Signal(TIME, COMMAND[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measurement[:, None], ("x",), "um"),
    }
    return Record(signals, source)


def test_what_is_left_of_the_memory_is_gone_when_the_command_has_met_both_extremes():
    half = np.array([0.05, 0.2, 0.45]) * SPAN
    left = left_of_memory(COMMAND, half)
    np.testing.assert_allclose(left[0], 2.0 * half)
    assert (np.diff(left, axis=0) <= 1e-12).all() and not left[FILLED:].any() and left[FILLED // 4].any()


def test_another_history_is_no_effect_and_hides_none():
    clean, new = machine((0.0, 100.0), 1), machine((20.0, 50.0), 2, gain=0.95)
    away = np.abs(new / 0.95 - clean)
    assert away[:FILLED].max() > 0.1 and away[FILLED:].max() < 0.02  # it is there, and only there
    report, *_ = diagnosed([record(new, "new")], None, cache=False, baseline=[record(clean, "clean")])
    assert report["verdict"] == "effect" and [effect["name"] for effect in report["effects"]] == ["gain"]
    assert abs(report["effects"][0]["parameters"]["gain"]["value"] + 0.05) < 2e-3
    same, *_ = diagnosed([record(machine((20.0, 50.0), 3), "new")], None, cache=False, baseline=[record(clean, "clean")])
    assert same["verdict"] == "no_gap"
