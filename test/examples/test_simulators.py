# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators of other people beside machines with an effect that these lack: the verdict names it, with its size."""

from __future__ import annotations

import sys
from importlib import import_module

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.cli import main

CASES = {
    "linear_system": ("saturation", "upper", 30.0, 1.0),
    "network": ("sensor_lowpass", "cutoff", 15.0, 1.0),
    "mujoco_joint": ("backlash", "half_width", 20.0, 1.0),
    "fmu_stage": ("delay", "tau", 4e-3, 1e-4),
}
NEEDED = {"mujoco_joint": "mujoco", "fmu_stage": "fmpy"}


@pytest.mark.parametrize("name", CASES)
def test_the_withheld_effect_is_named(name):
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    example, (effect, parameter, size, within) = import_module(f"simulators.{name}"), CASES[name]
    record = example.measured()
    gap = hc.diagnose(record, example.simulate, parameters=example.PARAMETERS, verbose=False)
    print(gap)
    found = {each["name"]: each["parameters"] for each in gap.document["effects"]}
    assert gap.verdict == "effect" and list(found) == [effect]
    assert abs(found[effect][parameter]["value"] - size) < within
    command, measurement = (record.signal(topic).values for topic in ("command", "measurement"))
    nominal = example.simulate(command[:, 0], 1.0 / example.RATE, **{key: value[0] for key, value in example.PARAMETERS.items()})
    better = gap.model.simulate(command, example.RATE).signal("measurement").values
    assert np.std(measurement - better) < 0.4 * np.std(measurement[:, 0] - nominal)


def test_the_command_takes_a_function_by_name(tmp_path, monkeypatch, capsys):
    from simulators.linear_system import measured

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    measured().save("record")
    (tmp_path / "prior.yaml").write_text("frequency: [80.0, 1.0, Hz]\n")
    (tmp_path / "stage_of_mine.py").write_text("def simulate(command, sample_time, frequency):\n    return 1 / 0\n")
    arguments = ["diagnose", "record", "--simulator", "stage_of_mine:simulate", "--parameters", "prior.yaml"]
    assert main(arguments) == 2
    assert "simulator simulate: ZeroDivisionError: division by zero" in capsys.readouterr().err
    assert main([*arguments, "--augmented", "better.yaml"]) == 2
    assert "better.yaml: a Python function is no model file" in capsys.readouterr().err
    assert main([*arguments, "--learned-residual"]) == 2
    assert "--learned-residual: is a stage of a model file, which a Python function is not" in capsys.readouterr().err
    assert main(["diagnose", "record", "--parameters", "prior.yaml"]) == 2
    assert "--parameters prior.yaml: are those of a simulator" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "package"), NEEDED.items())
def test_an_example_without_its_package_is_one_line(name, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"simulators.{name}", raising=False)
    with pytest.raises(SystemExit, match=f"{name}: needs .*: pip install"):
        import_module(f"simulators.{name}")
