# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The model file: what is written is read back the same, and everything else is refused with one line that helps."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hyst_control.base.config_files import config_folders
from hyst_control.base.errors import InputError
from hyst_control.chain import STAGES
from hyst_control.chain.chain import Chain, Parallel
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.memoryless import Gain, Quantization
from hyst_control.model_file import Model, Simulator, load_model, model_from_document, model_to_document, save_model, simulate

SHIPPED = sorted(path for folder in config_folders()[:1] for path in (folder / "models").glob("*.yaml"))
DOCUMENT = """\
format: hyst_control/model
version: 1
name: example
axes: [x, y]
units: {command: V, measurement: mrad}
sample_time: 1e-4
hold: zoh
valid: {command: [0.0, 100.0], frequency: [0.0, 500.0]}
chain:
  - {stage: delay, tau: [6.8e-5, 7e-5]}
  - stage: parallel
    branches:
      - - {stage: madelung, ascending: [0.5, 0.5], descending: [[-0.5, 1.5], [-0.25, 1.25]], input_scale: 100.0, output_scale: 2.0}
      - - {stage: rate_correction, k1: -7.9e-6, k2: 7e-4}
        - {stage: gain, gain: 1}
  - {stage: prandtl_ishlinskii, thresholds: [0.1, 0.2], weights: [1.0, 0.5]}
  - {stage: transfer_function, num: [4e7], den: [1.0, 900.0, 4e7]}
noise: {sigma: [0.001, 0.002]}
tolerance: {tau: 0.02, madelung.ascending: 0.01}
"""


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "model.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_model(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path)), message
    return message


def test_a_number_with_an_exponent_is_a_number(tmp_path):
    """YAML 1.1 reads 1e-4 as text; 4e7 and 7e-5 stand for themselves here."""
    model = load_model(written(tmp_path, DOCUMENT))
    assert model.sample_time == 1e-4
    assert model.chain.stages[0].tau == (6.8e-5, 7e-5)
    assert model.chain.stages[3].num == (4e7,)


def test_load_save_load_is_the_identity(tmp_path):
    model = load_model(written(tmp_path, DOCUMENT))
    save_model(model, tmp_path / "again.yaml")
    again = load_model(tmp_path / "again.yaml")
    assert again == model
    assert model_to_document(again) == model_to_document(model)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.yaml", "model.yaml"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_model_loads_runs_and_survives_saving(path, tmp_path):
    model = load_model(path)
    save_model(model, tmp_path / "again.yaml")
    assert load_model(tmp_path / "again.yaml") == model
    command = 30.0 + 20.0 * np.sin(np.linspace(0, 20, 500))[:, None] * np.ones(len(model.axes))
    assert np.all(np.isfinite(simulate(model, command)))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    numbers=st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=5),
    tau=st.floats(0.0, 1e-2),
    name=st.text(max_size=20),
    sample_time=st.floats(1e-6, 1.0),
)
@example(numbers=[1.0], tau=0.0, name="1e3", sample_time=1.0)
@example(numbers=[1.0], tau=0.0, name="0E0", sample_time=1.0)
def test_every_float_and_name_survives_to_the_last_bit(numbers, tau, name, sample_time, tmp_path):
    stages = (Delay(tau), PrandtlIshlinskii(tuple(range(len(numbers))), numbers), Gain(numbers[0]))
    units = {"command": "V", "measurement": "um"}
    model = Model(name, ("x",), units, sample_time, Chain(stages), tolerance={"weights": abs(numbers[-1])})
    save_model(model, tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml") == model


def test_what_stands_at_its_default_is_not_written():
    document = model_to_document(
        Model("m", ("x",), {"command": "V", "measurement": "um"}, 1e-3, Chain((Madelung([1], [1], 1, 1),)))
    )
    assert list(document["chain"][0]) == ["stage", "ascending", "descending", "input_scale", "output_scale"]
    assert "noise" not in document and "valid" not in document


def test_save_model_replaces_at_once_or_not_at_all(tmp_path):
    model = load_model(written(tmp_path, DOCUMENT))
    with pytest.raises(InputError, match="choose a folder"):
        save_model(model, tmp_path / "nowhere" / "model.yaml")
    unwritable = Model("m", ("x",), model.units, 1e-3, Chain((Gain(1.0),)), noise={"sigma": object()})
    before = (tmp_path / "model.yaml").read_bytes()
    with pytest.raises(yaml.YAMLError):
        save_model(unwritable, tmp_path / "model.yaml")
    assert (tmp_path / "model.yaml").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["model.yaml"]


BAD_TEXT = [
    ("sample_time: 1e-4", "sampel_time: 1e-4", "sampel_time: no such key: did you mean 'sample_time'?"),
    ("sample_time: 1e-4", "", "sample_time: is missing"),
    ("sample_time: 1e-4", "sample_time: -1e-4", "sample_time: -0.0001, a positive time in s is due"),
    ("sample_time: 1e-4", "sample_time: .nan", "sample_time: nan"),
    ("sample_time: 1e-4", "sample_time: yes", "sample_time: True"),
    ("sample_time: 1e-4", "sample_time: 1e-4\nsample_time: 1e-3", "the key 'sample_time' stands twice"),
    ("format: hyst_control/model", "format: something", "format: 'something'"),
    ("version: 1", "version: 2", "version: 2"),
    ("version: 1", "version: true", "version: True"),
    ("name: example", "name: [1, 2]", "name: [1, 2]"),
    ("axes: [x, y]", "axes: x", "axes: 'x', a list of names"),
    ("axes: [x, y]", "axes: [x, x]", "axes: ['x', 'x'] names an axis twice"),
    ("axes: [x, y]", "axes: [x, y, z]", "chain[0] (delay): tau: 2 values for 3 axes"),
    ("measurement: mrad", "measurement: nm", "units.measurement: 'nm', um or mrad is due"),
    ("measurement: mrad", "measurment: mrad", "units.measurement: None, um or mrad is due"),
    ("{command: V, measurement: mrad}", "V", "units.command: 'V', V is due"),
    ("hold: zoh", "hold: sample", "hold: 'sample', one of zoh, foh is due"),
    ("command: [0.0, 100.0]", "command: [100.0, 0.0]", "valid.command: [100.0, 0.0], [lower, upper] is due"),
    ("command: [0.0, 100.0]", "commands: [0.0, 100.0]", "valid.commands: no such key"),
    ("stage: delay", "stage: dealy", "chain[0].stage: 'dealy' is not a stage: did you mean 'delay'?"),
    ("stage: delay, tau", "stage: delay, tua", "chain[0] (delay).tua: no such parameter: did you mean 'tau'?"),
    ("stage: delay, tau: [6.8e-5, 7e-5]", "stage: delay", "chain[0] (delay).tau: is missing"),
    ("[6.8e-5, 7e-5]", "[6.8e-5, -7e-5]", "chain[0] (delay): tau: must be a number >= 0 s, got -7e-05"),
    ("[6.8e-5, 7e-5]", "[6.8e-5, .inf]", "chain[0] (delay): tau: must be a finite number >= 0 s, got inf"),
    ("[6.8e-5, 7e-5]", "[[6.8e-5, 7e-5]]", "chain[0] (delay): tau"),
    ("[6.8e-5, 7e-5]", "soon", "chain[0] (delay): tau: must be a number >= 0 s, got 'soon'"),
    ("[6.8e-5, 7e-5]", "1e12", "chain[0] (delay): tau: "),
    ("thresholds: [0.1, 0.2]", "thresholds: [0.2, 0.1]", "chain[2] (prandtl_ishlinskii): thresholds: 0.2 V is followed by 0.1 V"),
    ("thresholds: [0.1, 0.2]", "thresholds: [0.1]", "chain[2] (prandtl_ishlinskii): weights: 2 weights for 1 thresholds"),
    ("thresholds: [0.1, 0.2]", "thresholds: [0.1, [0.2]]", "chain[2] (prandtl_ishlinskii)"),
    ("ascending: [0.5, 0.5]", "ascending: [0.5, 0.6]", "chain[1].branches[0][0] (madelung): descending: ends at 1 "),
    ("ascending: [0.5, 0.5]", "ascending: [3.0, -2.0]", "chain[1].branches[0][0] (madelung): ascending: the curve falls"),
    ("k2: 7e-4", "k2: 0", "chain[1].branches[1][0] (rate_correction): k2: must be a number > 0 s, got 0"),
    ("den: [1.0, 900.0, 4e7]", "den: [1.0, 900.0, 0.0]", "chain[3] (transfer_function): den: the system integrates"),
    ("num: [4e7]", "num: [1.0, 1.0, 1.0, 4e7]", "chain[3] (transfer_function): num: degree 3"),
    ("sigma: [0.001, 0.002]", "sigma: [0.001, 0.002, 0.003]", "noise.sigma: [0.001, 0.002, 0.003]"),
    ("sigma: [0.001, 0.002]", "sigma: -1", "noise.sigma: -1"),
    ("tau: 0.02", "tau: some", "tolerance.tau: 'some'"),
    ("noise: {sigma", "noise: {rms", "noise: a mapping with sigma alone"),
    ("chain:", "chain: []\nformer:", "former: no such key"),
]


@pytest.mark.parametrize("old, new, message", BAD_TEXT, ids=[f"{new[:40]}" for _, new, _ in BAD_TEXT])
def test_a_bad_document_is_refused_with_one_line(old, new, message, tmp_path):
    assert DOCUMENT.count(old) == 1
    assert message in refusal(written(tmp_path, DOCUMENT.replace(old, new)))


@pytest.mark.parametrize(
    "content, message",
    [
        ("", "is not a model file"),
        ("- 1\n- 2\n", "is not a model file"),
        ("format: [unclosed\n", "line 2 is not valid YAML"),
        ("a: b: c\n", "is not valid YAML"),
        ("? [1, 2]\n: 3\n", "is not valid YAML"),
        ("!!python/object:os.system {}\n", "is not valid YAML"),
        (b"\x89MCAP0\r\n\x00\xff\xfe" * 10, "is not a text file"),
        (b"\x00\x01\x02", "is not valid YAML"),
        ("[" * 5000, "nested more than 64 deep"),
        ("&a [*a]\n", "stands within itself"),
        ("x: 1" + "0" * 6000, ""),
    ],
)
def test_what_is_no_model_file_is_refused_with_one_line(content, message, tmp_path):
    assert message in refusal(written(tmp_path, content))


def test_a_file_that_is_not_there(tmp_path):
    assert "No such file" in refusal(tmp_path / "missing.yaml")
    assert "directory" in refusal(tmp_path)


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([10**400, -(10**30), 1e300, -1e300, 5e-324, float("nan"), float("inf"), 0.0]),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats(-2, 2), max_size=4),
    st.lists(st.lists(st.floats(-2, 2), max_size=3), max_size=3),
    st.dictionaries(st.sampled_from(["stage", "tau", "x", 1]), st.integers(0, 2), max_size=2),
    st.sampled_from(sorted(STAGES)).map(lambda name: {"stage": name}),
)


def places(node, path=()):
    """Paths of every value in nested dictionaries and lists."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


PARSED = yaml.safe_load(
    DOCUMENT.replace("4e7", "4.0e+7").replace("7e-4", "7.0e-4").replace("1e-4", "1.0e-4").replace("7e-5", "7.0e-5")
)
PLACES = list(places(PARSED))


@settings(max_examples=200, deadline=None)
@given(
    changes=st.lists(
        st.tuples(st.sampled_from(PLACES), st.sampled_from(["replace", "delete", "rename"]), JUNK), min_size=1, max_size=3
    )
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.linalg.LinAlgWarning")
def test_a_mutated_document_is_a_model_or_an_input_error(changes):
    document = copy.deepcopy(PARSED)
    for path, action, junk in changes:
        node = document
        try:
            for key in path[:-1]:
                node = node[key]
            if action == "replace":
                node[path[-1]] = junk
            elif action == "delete":
                del node[path[-1]]
            elif isinstance(node, dict):
                node[f"{path[-1]}_"] = node.pop(path[-1])
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took the place away
    try:
        model = model_from_document(document)
    except InputError as error:
        assert "\n" not in str(error)
        return
    model_to_document(model)
    Simulator(model).reset(np.full(len(model.axes), 10.0))


@settings(max_examples=100, deadline=None)
@given(name=st.sampled_from(sorted(set(STAGES) - {"parallel"})), data=st.data())
@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.linalg.LinAlgWarning")
def test_any_stage_with_any_parameters_is_a_model_or_an_input_error(name, data):
    from dataclasses import fields

    row = {"stage": name, **{field.name: data.draw(JUNK, label=field.name) for field in fields(STAGES[name]) if field.name != "x"}}
    document = {**PARSED, "axes": ["x"], "chain": [row], "noise": None, "tolerance": None, "valid": None}
    try:
        model = model_from_document(document)
    except InputError as error:
        assert "\n" not in str(error)
        return
    Simulator(model).reset(np.full(1, 10.0))


def test_a_simulator_gives_the_measurement_that_follows_each_command():
    stages = (Parallel(((Delay(2e-4), TransferFunction([4e7], [1.0, 900.0, 4e7])), (Gain(0.3),))), Quantization(1e-6))
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, 1e-4, Chain(stages))
    command = np.cumsum(np.random.default_rng(1).normal(size=(50, 1)), axis=0)
    simulator = Simulator(model)
    first = simulator.reset(command[0])
    following = simulator.step(command)
    np.testing.assert_array_equal(simulate(model, command), np.concatenate([first[None], following[:-1]]))
    assert (simulator.axes, simulator.sample_time, simulator.units["measurement"]) == (("x",), 1e-4, "um")
    # A plant that is run at another clock is still the same continuous plant: a step's end value does not change.
    fast = Simulator(model, sample_time=2e-5)
    fast.reset(command[0])
    step = np.full((2500, 1), 3.0)
    simulator.reset(command[0])
    np.testing.assert_allclose(fast.step(step)[-1], simulator.step(step[:500])[-1], atol=2e-6)
