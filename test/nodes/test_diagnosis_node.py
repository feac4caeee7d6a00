"""The diagnosis node beside a closed loop: silent while the plant is the model within its tolerance, and not once it is not."""

from __future__ import annotations

import json

import numpy as np
import pytest
from loop_case import MODEL, RATE, parameters
from std_srvs.srv import Trigger

from hyst_control.diagnose.scatter import scatter_of
from hyst_control.errors import InputError
from hyst_control.model_file import Simulator, load_model, simulate
from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.pipeline import DEFAULT, NODES
from hyst_plant_sim.node import PlantNode
from hyst_plant_sim.physics import load_plant

WINDOW, CONSECUTIVE = 0.02, 3
SETTINGS = {"model": MODEL, "rate_hz": RATE, "window": WINDOW, "settle": 0.02, "calibrate": 0.1, "consecutive": CONSECUTIVE}


class Noisy:
    """A scattered model with white noise, as a plant."""

    def __init__(self, model, seed):
        scatter = scatter_of(model)
        self._random = np.random.default_rng(seed)
        self._inner = Simulator(model.with_stages(scatter.at(self._random.standard_normal(len(scatter.coefficients)))), 1 / RATE)
        self._sigma = model.noise["sigma"]
        self.axes, self.units = self._inner.axes, self._inner.units

    def reset(self, command):
        return self._inner.reset(command) + self._sigma * self._random.standard_normal(1)

    def step(self, commands):
        return self._inner.step(commands) + self._sigma * self._random.standard_normal(commands.shape)


def run_loop(bench, tmp_path, plant, count, **changes):
    """The closed loop with this plant, composed, to its end; the diagnosis node, and what it said by window and by tick."""
    settings = parameters(tmp_path, count)
    bench.listen("gap", "residual")
    node = bench.add(DiagnosisNode, output=str(tmp_path / "diagnosis"), **{**SETTINGS, **changes})
    nodes = {}
    for name in DEFAULT:
        make = NODES[name] if name != "plant" else lambda **options: PlantNode(plant=plant, **options)
        nodes[name] = bench.add(make, **settings[name])
    bench.until(lambda: nodes["plant"].finished.done() and nodes["recorder"].finished.done(), timeout=60)
    bench.until(lambda: len(bench.rows("residual")) >= count)
    return node, bench.rows("gap"), bench.rows("residual")


def once(rows):
    """Without what lockstep repeated."""
    return rows[np.unique(rows[:, 0], return_index=True)[1]]


def test_silent_beside_a_plant_within_tolerance(bench, tmp_path):
    model, count = load_model(MODEL), 16000
    bench.listen("command", "measurement")
    _, gap, residual = run_loop(bench, tmp_path, Noisy(model, 5), count)
    assert len(gap) >= (count / RATE - 0.02) / WINDOW - 1
    assert not gap[:, 2].any()
    command, measurement = (once(bench.rows(topic))[:count] for topic in ("command", "measurement"))
    # by tick, and what simulating the whole record at once gives
    np.testing.assert_array_equal(residual[:, 0], measurement[:, 0])
    np.testing.assert_allclose(residual[:, 1:], measurement[:, 1:] - simulate(model, command[:, 1:], 1 / RATE), atol=1e-9)
    last = residual[:, 0] <= gap[-1, 0] + 1e-9
    rows = residual[last][-round(WINDOW * RATE):, 1]
    assert gap[-1, 1] == pytest.approx(100 * np.sqrt(np.mean(rows ** 2)) / np.ptp(measurement[round(0.02 * RATE):][:, 1]), rel=0.05)


def test_alarm_and_diagnosis_once_a_delay_switches_on(bench, tmp_path):
    plant = load_plant({"plant": "pea_published", "seed": 3, "effects": [{"name": "delay", "tau": 2e-4, "from": 0.4}]},
                       sample_time=1 / RATE)
    bench.listen_to_diagnostics()
    node, gap, _ = run_loop(bench, tmp_path, plant, 14000, buffer=0.25)
    alarmed = gap[gap[:, 2] > 0, 0]
    assert 0.4 < alarmed[0] <= 0.4 + (CONSECUTIVE + 1) * WINDOW
    assert gap[-1, 2] == 1.0
    bench.until(lambda: bench.says("diagnosis", "gap alarm"))
    started = bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request())
    assert started.success and started.message.startswith("started")
    assert "running" in bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).message
    bench.until(lambda: not node._job.running, timeout=180)
    told = bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).message
    assert "delay" in told
    [report] = (tmp_path / "diagnosis").glob("*/gap.json")
    document = json.loads(report.read_text())
    assert "delay" in [effect["name"] for effect in document["effects"]] + \
        [name for effect in document["effects"] for name in effect["equivalent"]]
    bench.until(lambda: told in bench.said["/diagnosis: loop"]["diagnosis"])
