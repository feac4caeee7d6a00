# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The functional mock-up unit, driven through its own binary as a simulator would: to the bit what Python computes."""

from __future__ import annotations

import ctypes
import shutil
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.chain import Sampling
from hyst_control.cli import main
from hyst_control.control.feedback.pi import PI
from hyst_control.export.compiled import COMPILERS
from hyst_control.export.controller import Controller, FaultResponse
from hyst_control.model_file import load_model

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason=f"no C compiler: none of {', '.join(COMPILERS)} is installed"
)
LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
RELEASE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
FINISHED = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int)
CONTROLLER = """
/**: {ros__parameters: {rate_hz: 5000.0, axes: [x], unit: um}}
pi_feedback: {ros__parameters: {kp: 0.5, ki: 900.0, upper: 50.0, notch_frequency: [1000.0]}}
"""


class Callbacks(ctypes.Structure):
    _fields_ = [
        ("log", LOG),
        ("allocate", ALLOCATE),
        ("release", RELEASE),
        ("finished", FINISHED),
        ("environment", ctypes.c_void_p),
    ]


class Unit:
    """One instance of a unit, by its modelDescription.xml and the binary that lies in it."""

    def __init__(self, path, folder):
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        self.description = ElementTree.parse(folder / "modelDescription.xml").getroot()
        (binary,) = (folder / "binaries").glob("*/*")
        self.library = ctypes.CDLL(str(binary))
        self.library.fmi2Instantiate.restype = self.library.fmi2GetVersion.restype = ctypes.c_void_p
        self.said = []
        self.callbacks = Callbacks(
            LOG(lambda *words: self.said.append(words[-1].decode())), ALLOCATE(), RELEASE(), FINISHED(), None
        )
        self.at = {
            causality: [
                int(each.get("valueReference"))
                for each in self.description.iter("ScalarVariable")
                if each.get("causality") == causality
            ]
            for causality in ("input", "output")
        }
        self.instance = ctypes.c_void_p(self.instantiated(self.description.get("guid")))
        assert self.instance.value
        self.call("SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))

    def instantiated(self, guid):
        return self.library.fmi2Instantiate(b"one", 1, guid.encode(), b"", ctypes.byref(self.callbacks), 0, 0)

    def call(self, name, *given):
        return getattr(self.library, f"fmi2{name}")(self.instance, *given)

    def real(self, name, references, values):
        array = (ctypes.c_double * len(references))(*values)
        assert self.call(name, (ctypes.c_uint * len(references))(*references), ctypes.c_size_t(len(references)), array) == 0
        return list(array)

    def settle(self, row):
        assert self.call("EnterInitializationMode") == 0
        self.real("SetReal", self.at["input"], row)
        assert self.call("ExitInitializationMode") == 0
        return self.real("GetReal", self.at["output"], [0.0] * len(self.at["output"]))

    def step(self, row, time, step):
        self.real("SetReal", self.at["input"], row)
        assert self.call("DoStep", ctypes.c_double(time), ctypes.c_double(step), 1) == 0
        return self.real("GetReal", self.at["output"], [0.0] * len(self.at["output"]))

    def run(self, rows, step):
        return np.array([self.step(row, k * step, step) for k, row in enumerate(rows)])


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    assert main(["export", str(config_path("models/fsm_mhl.yaml")), "--fmu", "--output", str(folder / "plant.fmu")]) == 0
    return folder / "plant.fmu"


@pytest.fixture
def unit(plant, tmp_path):
    return Unit(plant, tmp_path)


def rows(count: int, axes: int) -> np.ndarray:
    time = np.arange(count)[:, None]
    return 50.0 + 30.0 * np.sin(0.05 * time + np.arange(axes)) * np.exp(-time / count)


def test_a_simulator_is_that_of_python_to_the_bit_and_returns_to_a_saved_state(unit):
    model, command = load_model(config_path("models/fsm_mhl.yaml")), rows(400, 2)
    python = model.chain.filter(Sampling(model.sample_time, 2, "zoh"))
    np.testing.assert_array_equal(unit.settle(command[0]), python.settle(command[0].copy()))
    expected = python.process(command)
    np.testing.assert_array_equal(unit.run(command[:200], model.sample_time), expected[:200])
    state, size, other = ctypes.c_void_p(), ctypes.c_size_t(), ctypes.c_void_p()
    assert unit.call("GetFMUstate", ctypes.byref(state)) == 0
    assert unit.call("SerializedFMUstateSize", state, ctypes.byref(size)) == 0
    held = ctypes.create_string_buffer(size.value)
    assert unit.call("SerializeFMUstate", state, held, size) == 0
    unit.run(command[:50], model.sample_time)
    assert unit.call("DeSerializeFMUstate", held, size, ctypes.byref(other)) == 0 == unit.call("SetFMUstate", other)
    np.testing.assert_array_equal(unit.run(command[200:], model.sample_time), expected[200:])
    assert unit.call("FreeFMUstate", ctypes.byref(state)) == 0 and state.value is None
    assert unit.call("Reset") == 0
    unit.settle(command[0])
    np.testing.assert_array_equal(unit.run(command, model.sample_time), expected)


def test_a_long_communication_step_is_as_many_ticks_with_held_inputs(unit):
    model = load_model(config_path("models/fsm_mhl.yaml"))
    held = np.repeat(rows(40, 2), 5, axis=0)
    python = model.chain.filter(Sampling(model.sample_time, 2, "zoh"))
    unit.settle(held[0]), python.settle(held[0].copy())
    np.testing.assert_array_equal(unit.run(held[::5], 5 * model.sample_time), python.process(held)[4::5])
    for wrong in (0.5 * model.sample_time, 1.5 * model.sample_time, 0.0, np.nan):
        assert unit.call("DoStep", ctypes.c_double(0.0), ctypes.c_double(wrong), 1) == 3
    assert "whole number of ticks" in unit.said[0]


def test_a_controller_with_filters_too(tmp_path):
    (tmp_path / "loop.yaml").write_text(CONTROLLER)
    assert main(["export", str(tmp_path / "loop.yaml"), "--fmu", "--output", str(tmp_path / "loop.fmu")]) == 0
    unit = Unit(tmp_path / "loop.fmu", tmp_path / "unit")
    from hyst_control.control.feedback.filters import Filters

    law = PI(0.5, 900.0, 2e-4, 0.0, 50.0, filters=Filters(notch_frequency=(1000.0,)))
    table = np.column_stack([rows(300, 1) / 10, rows(300, 1)[::-1] / 10, np.ones(300)])
    python = Controller(law, 1, FaultResponse())
    unit.settle(table[0])
    np.testing.assert_array_equal(unit.run(table, 2e-4), python.process(table))
    names = [each.get("name") for each in unit.description.iter("ScalarVariable")]
    assert names == ["reference_x", "measurement_x", "enable", "command_x", "feedback_x", "feedforward_x", "fault"]


def test_what_is_no_variable_or_another_units_guid_is_refused(unit):
    array = (ctypes.c_double * 1)()
    assert unit.call("SetReal", (ctypes.c_uint * 1)(2), ctypes.c_size_t(1), array) == 3, "an output is not set"
    assert unit.call("GetReal", (ctypes.c_uint * 1)(4), ctypes.c_size_t(1), array) == 3
    assert unit.call("GetInteger", None, ctypes.c_size_t(0), None) == 0
    assert unit.instantiated("{another}") is None


def test_the_same_model_gives_the_same_bytes_and_every_function_of_the_standard_is_there(plant, unit, tmp_path):
    again = tmp_path / "again.fmu"
    assert main(["export", str(config_path("models/fsm_mhl.yaml")), "--fmu", "--output", str(again)]) == 0
    assert again.read_bytes() == plant.read_bytes()
    common = "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment EnterInitializationMode"
    common += (
        " ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString"
    )
    common += " GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate"
    common += " GetDirectionalDerivative SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus"
    common += " GetIntegerStatus GetBooleanStatus GetStringStatus"
    for name in common.split():
        assert hasattr(unit.library, f"fmi2{name}"), name
    assert ctypes.string_at(unit.library.fmi2GetVersion()) == b"2.0"


def test_fmpy_takes_it_for_valid(plant):
    validation = pytest.importorskip("fmpy.validation", reason="fmpy is not installed: pip install FMPy")
    assert validation.validate_fmu(str(plant)) == []
