# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A distribution that adds a stage, an effect, an estimator and a controller, and two that are broken, installed beside this package."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from hyst_control.base import plugins

SETUP = """
from setuptools import setup
setup(name="{name}", version="1.2", py_modules=["{module}"], entry_points={points})
"""

RIPPLE = '''
"""Interpolation error of an encoder: periodic in the position."""
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain import Chain
from hyst_control.chain.c_code.c_code import each_axis
from hyst_control.chain.memoryless import Gain, StaticFilter
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Stage, per_axis_scalars, register
from hyst_control.control.feedforward.compensator import Compensator
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.identify import Estimator, Fit, Options, option
from hyst_control.identify.data.fit import check_records
from hyst_control.identify.assess.fit_report import record_rows
from hyst_control.identify.families.options import NUMBER
from hyst_control.model_file import Model


@register
@dataclass(frozen=True)
class Ripple(Stage):
    """y = u + amplitude sin(2 pi u / pitch), measurement unit."""

    name: ClassVar[str] = "ripple"
    amplitude: ScalarPerAxis = scalar("measurement unit", "greatest error")
    pitch: ScalarPerAxis = scalar("measurement unit", "period of the error")

    def filter(self, sampling):
        amplitude, pitch = per_axis_scalars(self, sampling.axes, "amplitude", "pitch")
        code = each_axis(
            "u + (p->amplitude[i] * M(sin)((p->full_turn[i] * u) / p->pitch[i]))",
            "ripple",
            {
                "amplitude": (amplitude, "measurement unit"),
                "pitch": (pitch, "measurement unit"),
                "full_turn": (np.full(sampling.axes, 2.0 * np.pi), "rad"),
            },
        )
        return StaticFilter(lambda u: u + amplitude * np.sin(2.0 * np.pi * u / pitch), sampling.hold, code)

    def linearized(self, axes):
        return ()


EFFECT = Effect(
    "ripple",
    "sensor",
    "The encoder's interpolation errs within its pitch.",
    lambda around: (Parameter("amplitude", "unit", 0.0, (0.002 * around.stroke,), -0.05 * around.stroke, 0.05 * around.stroke,
                              0.01 * around.stroke),),
    lambda values, around: Ripple(values["amplitude"], 2.0),
)


@dataclass(frozen=True)
class RippleOptions(Options):
    """Choices of a fit of a ripple."""

    pitch: float = option(2.0, NUMBER, "period of the error", unit="measurement unit", lower=1e-6)


class RippleFamily(Estimator[RippleOptions]):
    """A gain and a ripple, by two linear fits."""

    name = "ripple"
    sentence = "a gain and the interpolation error of an encoder"
    Options = RippleOptions

    def fit(self, records, options):
        check_records(records)
        data = records[0]
        held = np.concatenate([data.command[:1], data.command[:-1]])  # what the measurement of a tick answers
        gain = amplitude = 0.0
        for _ in range(20):
            wave = np.sin(2.0 * np.pi * gain * held / options.pitch)
            gain = float(np.sum(held * (data.measurement - amplitude * wave)) / np.sum(held**2))
            wave = np.sin(2.0 * np.pi * gain * held / options.pitch)
            amplitude = float(np.sum(wave * (data.measurement - gain * held)) / np.sum(wave**2))
        chain = Chain((Gain(gain), Ripple(amplitude, options.pitch)))
        model = Model("ripple", data.axes, {"command": "V", "measurement": data.unit}, data.sample_time, chain)
        rows, _ = record_rows(model, records)
        parameters = [{"name": "amplitude", "value": amplitude, "standard_error": None, "unit": data.unit}]
        report = {"family": self.name, "method": options.method, "unit": data.unit, "records": rows, "parameters": parameters, "notes": []}
        return Fit(model, report)


def halved(model, design):
    """Half a volt per unit."""
    return Compensator([Gain(0.5), design.rating], model, design.sample_time, 0, 0, design.limits)
'''

POINTS = {
    "hyst_control.stages": ["ripple = acme_ripple:Ripple"],
    "hyst_control.effects": ["ripple = acme_ripple:EFFECT"],
    "hyst_control.estimators": ["ripple = acme_ripple:RippleFamily"],
    "hyst_control.controllers": ["halved = acme_ripple:halved"],
}

BROKEN = {
    "hyst_control.stages": ["amiss = broken_stage:Amiss"],
    "hyst_control.effects": ["gain = acme_ripple:EFFECT", "number = broken_numbers:NUMBER"],
    "hyst_control.estimators": ["number = broken_numbers:NUMBER"],
    "hyst_control.controllers": ["number = broken_numbers:NUMBER"],
}

TWIN = """
from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.stage import Stage, register


@register
@dataclass(frozen=True)
class Twin(Stage):
    name: ClassVar[str] = "gain"
"""

TWINS = {"hyst_control.stages": ["gain = twin_gain:Twin"]}

MODEL = """
format: hyst_control/model
version: 1
name: stage
axes: [x]
units: {command: V, measurement: um}
sample_time: 1.0e-3
hold: zoh
valid: {command: [0.0, 10.0]}
chain:
  - {stage: transfer_function, num: [400.0], den: [1.0, 400.0]}
noise: {sigma: 0.001}
tolerance: {num: 0.01, den: 0.01}
"""


def write_sources(folder: Path, name: str, module: str, source: str, points: dict[str, list[str]]) -> str:
    """Sources of a distribution of one module; returns their folder."""
    folder = folder / name
    folder.mkdir()
    (folder / "setup.py").write_text(SETUP.format(name=name, module=module, points=points))
    (folder / f"{module}.py").write_text(source)
    return str(folder)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with the distributions in site/, a model, the same with a ripple, and a gain with a ripple."""
    folder = tmp_path_factory.mktemp("plugins")
    sources = [
        write_sources(folder, "acme-ripple", "acme_ripple", RIPPLE, POINTS),
        write_sources(folder, "broken-numbers", "broken_numbers", "NUMBER = 3\n", BROKEN),
        write_sources(folder, "twin-gain", "twin_gain", TWIN, TWINS),
    ]
    offline = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([sys.executable, "-m", "pip", "install", *offline, "--target", str(folder / "site"), *sources], check=True)
    (folder / "model.yaml").write_text(MODEL)
    (folder / "rippled.yaml").write_text(MODEL.replace("noise:", "  - {stage: ripple, amplitude: 0.05, pitch: 2.0}\nnoise:"))
    encoder = MODEL.replace("transfer_function, num: [400.0], den: [1.0, 400.0]", "gain, gain: 0.9").replace(
        "{num: 0.01, den: 0.01}", "{}"
    )
    (folder / "encoder.yaml").write_text(encoder.replace("noise:", "  - {stage: ripple, amplitude: 0.05, pitch: 2.0}\nnoise:"))
    return folder


def run(place: Path, program: str, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(place / "site"), "XDG_CACHE_HOME": str(place / "cache")}
    command = [sys.executable, "-c", program, *words]
    return subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=250, check=False)


HYST = """
import json, sys
from hyst_control.cli import main

def status(words):
    try:
        return main(words)
    except SystemExit as ended:  # of a help that was asked for
        return ended.code or 0

sys.exit(max(map(status, json.loads(sys.argv[1]))))
"""


def hyst(place: Path, *commands: list[str]) -> subprocess.CompletedProcess[str]:
    """Commands one after another in one process, which has to start and to find the plugins once."""
    done = run(place, HYST, json.dumps(commands))
    assert done.returncode == 0, done.stderr
    return done


def test_a_record_is_simulated_and_diagnosed_with_the_stage_and_the_effect_of_a_plugin(place):
    """The gap is the plugin's effect: nothing in this package's catalogue is periodic in the position."""
    excitation = ["--excitation", "diagnostic", "lowest=0", "highest=10", "duration=0.5"]
    hyst(
        place,
        ["simulate", "rippled.yaml", *excitation, "--seed", "1", "--output", "record"],
        ["diagnose", "record", "--model", "model.yaml", "--json", "gap.json", "--augmented", "better.yaml"],
    )
    found = json.loads((place / "gap.json").read_text())
    assert (found["verdict"], [effect["name"] for effect in found["effects"]]) == ("effect", ["ripple"])
    assert found["effects"][0]["parameters"]["amplitude"]["value"] == pytest.approx(0.05, rel=0.02)
    assert "stage: ripple" in (place / "better.yaml").read_text()
    hyst(place, ["simulate", "better.yaml", "record", "--output", "again"])  # the file with the plugin's stage is read back


def test_a_model_is_identified_by_the_estimator_of_a_plugin(place):
    """Its option is the command's, its model is read back, and its help says so; another family's option is refused."""
    excitation = ["--excitation", "diagnostic", "lowest=0", "highest=10", "duration=1"]
    hyst(
        place,
        ["simulate", "encoder.yaml", *excitation, "--output", "loops"],
        ["identify", "loops", "--model", "ripple", "--pitch", "2.0", "--output", "found.yaml", "--json", "fit.json"],
        ["simulate", "found.yaml", "loops", "--output", "replayed"],
    )
    fit = json.loads((place / "fit.json").read_text())
    assert fit["family"] == "ripple" and fit["parameters"][0]["value"] == pytest.approx(0.05, rel=0.02)
    words = ["identify", "loops", "--model", "ripple", "--operators", "5", "--output", "other.yaml"]
    refused = run(place, HYST, json.dumps([["identify", "--help"], words]))
    assert "the interpolation error of an encoder" in refused.stdout
    assert refused.returncode == 2 and "operators: ripple has no such option" in refused.stderr


def test_feedback_is_tuned_on_a_model_with_the_stage_of_a_plugin(place):
    """The stage says what it is for small signals: nothing, so the tuning is that of the model without it."""
    hyst(place, *(["tune", f"{model}.yaml", "--json", f"{model}.json"] for model in ("model", "rippled")))
    plain, rippled = (json.loads((place / f"{model}.json").read_text())["rows"] for model in ("model", "rippled"))
    figures = [(row["quantity"], row["value"]) for row in rippled]
    assert figures == [(row["quantity"], row["value"]) for row in plain] and any(value for _, value in figures)


def test_a_controller_of_a_plugin_is_built_by_its_name(place):
    program = """
from hyst_control.control.feedforward.compensator import KINDS, build_compensator
from hyst_control.model_file import load_model
import numpy as np
print("halved" in KINDS, build_compensator(load_model("model.yaml"), "halved").process(np.array([[4.0], [60.0]])).ravel().tolist())
"""
    done = run(place, program)
    assert done.stdout == "True [2.0, 10.0]\n", done.stderr  # held within the model's valid range


@pytest.mark.skipif(not shutil.which("gcc"), reason="gcc is not installed")
def test_a_model_with_the_stage_of_a_plugin_is_exported_with_its_c(place):
    hyst(place, ["export", "encoder.yaml", "--output", "encoder_c"])
    done = subprocess.run(["make", "-s", "-C", str(place / "encoder_c"), "test", "COMPILERS=gcc"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.count(" 0 wrong") == 2, done.stdout + done.stderr


def test_a_plugin_may_be_imported_before_this_package(place):
    done = run(place, "import acme_ripple; from hyst_control.effects import EFFECTS; print('ripple' in EFFECTS)")
    assert done.stdout == "True\n" and "acme" not in done.stderr


def test_a_broken_plugin_is_one_line_that_names_its_distribution(place):
    program = """
from hyst_control.chain import STAGES
from hyst_control.control.feedforward.compensator import KINDS
from hyst_control.effects import EFFECTS
from hyst_control.identify import estimators
print(len(STAGES) > 30, "ripple" in EFFECTS, "hampi" in KINDS, "number" in {**EFFECTS, **KINDS, **estimators()}, EFFECTS["gain"].name)
print(STAGES["gain"].__module__)
"""
    done = run(place, program)
    assert done.stdout == "True True True False gain\nhyst_control.chain.memoryless\n"
    lines = done.stderr.splitlines()
    (twin,) = (line for line in lines if "of twin-gain 1.2: cannot be used" in line)
    assert "gain: hyst_control.chain.memoryless has a stage of this name: choose another one" in twin
    lines.remove(twin)
    assert len(lines) == 5 and all("of broken-numbers 1.2: cannot be used" in line for line in lines)
    assert [line.split()[1] for line in lines] == ["amiss", "gain", "number", "number", "number"]
    assert "No module named 'broken_stage'" in lines[0]


@pytest.mark.parametrize("ending", ["raise SystemExit(0)", "import sys; sys.exit()", "raise ImportError('gone')"])
def test_a_plugin_that_ends_the_process_costs_itself_alone(ending, tmp_path, monkeypatch, caplog):
    (tmp_path / "ends_all.py").write_text(ending)
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("quits", "ends_all", "hyst_control.stages"), EntryPoint("sound", "json", "hyst_control.stages")]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points)
    found = []
    plugins.load("stages", lambda name, value: found.append(name))
    assert found == ["sound"]
    assert "plugin quits (hyst_control.stages)" in caplog.text and "cannot be used" in caplog.text
