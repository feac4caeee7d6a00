# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exported folders: every published model and every compensator of both papers compiles without a warning and equals Python."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported_folder import compared, export, fuzzed, make

from hyst_control.base.config_files import config_path
from hyst_control.cli import main
from hyst_control.control.feedforward.compensator import KINDS
from hyst_control.export import programs
from hyst_control.export.compiled import CompiledProgram
from hyst_control.model_file import load_model, simulate

pytestmark = pytest.mark.long_file

FIRST = f"COMPILERS={next(filter(shutil.which, ('gcc', 'clang')), 'gcc')}"
"""One compiler is enough where another program, which every compiler builds, contains the same stages (`test_odd_numbers` has all)."""
MODELS = sorted(path.name for path in Path(config_path("models/pea_hampi.yaml")).parent.glob("*.yaml"))
INVERSE = str(config_path("models/fsm_mhl_inverse.yaml"))
FEEDFORWARDS = {
    "hapi": ("pea_hapi.yaml", "--kind", "hapi", "--causal"),
    "hampi": ("pea_hampi.yaml", "--kind", "hampi", "--reference-ahead"),
    "hampi, Eq. 13": ("pea_hampi.yaml", "--kind", "hampi", "--iterations", "1", "--discretisation", "tustin", "--causal"),
    "hampi, exact": ("pea_hampi.yaml", "--kind", "hampi", "--iterations", "0", "--causal"),
    "none": ("pea_hampi.yaml", "--kind", "none"),
    "mhl": ("fsm_mhl.yaml", "--kind", "mhl"),
    "mhl, identified inverse": ("fsm_mhl.yaml", "--kind", "mhl", "--inverse-model", INVERSE, "--discretisation", "tustin"),
    "mhl, N without phase": (
        *("fsm_mhl.yaml", "--kind", "mhl", "--rate-filter", "0", "--smoothing", "4", "--inverse-model", INVERSE),
        *("--discretisation", "tustin", "--reference-ahead"),
    ),
    "mhl_static": ("fsm_mhl.yaml", "--kind", "mhl_static"),
    "whole inverse": ("fsm_mhl.yaml", "--kind", "mhl_inverse", "--causal"),
    "whole inverse, smoothed": ("fsm_mhl.yaml", "--kind", "mhl_inverse", "--smoothing", "4", "--reference-ahead"),
}
TRACKING = """
/**:
  ros__parameters: {rate_hz: 20000.0, axes: [x], unit: um}
hampi_feedforward:
  ros__parameters: {kind: hampi, model: MODEL, limits: [0.0, 50.0], learning: played, learned_file: learned.npy}
pi_feedback:
  ros__parameters:
    {kp: 0.34, ki: 13600.0, upper: 50.0, slew_limit: 2.0e+6, safe_command: [1.0], FILTERS}
"""
FILTERS = "kd: 1.0e-5, derivative_corner: 3.0e+3, notch_frequency: [1230.0, 4000.0], damping_gain: 0.5, damping_corner: 985.0"


@pytest.mark.parametrize("model", MODELS)
def test_a_published_model_compiles_and_equals_python(model, tmp_path):
    export(model, output=tmp_path)
    compared(tmp_path, *(() if model == "fsm_mhl.yaml" else (FIRST,)))


def test_no_kind_of_compensator_is_missing():
    assert {words[2] for words in FEEDFORWARDS.values()} >= set(KINDS)


@pytest.mark.parametrize("name", FEEDFORWARDS)
def test_a_compensator_compiles_and_equals_python(name, tmp_path):
    """In float too, and by every compiler, where stages come together that the others only have with other numbers."""
    export(*FEEDFORWARDS[name], output=tmp_path)
    compared(tmp_path, *{"hampi": (), "whole inverse": (FIRST,)}.get(name, (FIRST, "REALS=0")))


def test_the_feedforward_of_a_late_plant_is_small(tmp_path):
    """A delay of 503 samples on one of two axes: no matrix of as many states, and the same numbers as from Python."""
    mode = "{stage: transfer_function, num: [0.5], den: [1.583e-5, 2.387e-3, 1.0]}"
    (tmp_path / "late.yaml").write_text(
        "{format: hyst_control/model, version: 1, name: late, axes: [x, y], units: {command: V, measurement: um}, sample_time: 1.0e-4, "
        f"valid: {{command: [0.0, 100.0]}}, chain: [{{stage: delay, tau: [0.0503337, 1.0e-4]}}, {mode}]}}"
    )
    assert (
        main(["export", str(tmp_path / "late.yaml"), "--kind", "hampi", "--reference-ahead", "--output", str(tmp_path / "c")]) == 0
    )
    assert (tmp_path / "c" / "late_hampi.c").stat().st_size < 20_000
    compared(tmp_path / "c", FIRST)


def test_a_feedforward_says_what_it_leaves_out():
    model, options = load_model(config_path("models/fsm_mhl.yaml")), programs.FeedforwardOptions("mhl", preview=False)
    exported = programs.feedforward(model, options)
    assert exported.notes == ("The inverse leaves out the dynamics, the delay of the model.",)
    assert exported.notes[0] in exported.program.facts
    assert programs.feedforward(model, replace(options, kind="mhl_inverse")).notes == ()


def tracking(folder: Path, filters: str) -> str:
    """File of a controller with learned rows."""
    model = str(config_path("models/pea_hampi.yaml"))
    (folder / "tracking.yaml").write_text(TRACKING.replace("MODEL", model).replace("FILTERS", filters))
    np.save(folder / "learned.npy", np.sin(np.arange(50.0))[:, None])
    return str(folder / "tracking.yaml")


@pytest.mark.parametrize(
    "filters",
    [
        "roll_off: 0.0",
        "kd: 1.0e-5, derivative_corner: 3.0e+3",
        "damping_gain: 0.5, damping_corner: 985.0",
        "notch_frequency: [1230.0]",
    ],
)
def test_a_controller_with_few_filters_or_none_equals_python(filters, tmp_path):
    file = tracking(tmp_path, filters)
    assert main(["export", file, "--reference-ahead", "--output", str(tmp_path / "controller")]) == 0
    compared(tmp_path / "controller", FIRST)


def test_a_controller_its_loop_a_twin_and_float_too(tmp_path):
    file = tracking(tmp_path, FILTERS)
    assert main(["export", file, "--reference-ahead", "--output", str(tmp_path / "controller")]) == 0
    compared(tmp_path / "controller")
    fuzzed(tmp_path / "controller")
    assert "SHA-256" in (tmp_path / "controller" / "tracking.h").read_text()
    loop = ["export", file, "--plant", str(config_path("models/pea_hampi.yaml"))]
    assert main([*loop, "--reference-ahead", "--output", str(tmp_path / "loop")]) == 0
    told = make(tmp_path / "loop", "run", "SECONDS=0.2")
    assert "4000 ticks at 20000 Hz" in told and "0 ticks with a fault" in told
    error = re.search(r"error ([\d.]+) % of the range", told)
    assert error and float(error[1]) < 10.0, told  # the rows learned in this test are no good ones
    export("fsm_mhl.yaml", "--twin", "--real", "float", output=tmp_path / "twin")
    compared(tmp_path / "twin", FIRST)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_simulator_and_twin_have_the_hold_of_the_model(hold):
    """To the bit what `simulate` says of the model's own record."""
    model = replace(load_model(config_path("models/fsm_mhl.yaml")), hold=hold)
    command = 50.0 - 45.0 * np.cos(0.03 * np.arange(600))[:, None] * np.ones(2)
    measured = simulate(model, command)
    plant = CompiledProgram(programs.simulator(model).program)
    first = plant.settle(command[0])
    answer = plant.process(command)
    np.testing.assert_array_equal(answer if hold == "foh" else np.vstack([first, answer[:-1]]), measured)
    twin, both = programs.twin(model), np.hstack([command, measured])
    for running in (CompiledProgram(twin.program), twin.python):
        running.settle(both[0])
        np.testing.assert_array_equal(running.process(both), 0.0)


def test_what_holds_its_command_says_where_the_model_does_not(tmp_path, capsys):
    assert main(["export", INVERSE, "--output", str(tmp_path / "c")]) == 0
    assert "Hold foh: the command is a straight line" in capsys.readouterr().out
    assert main(["export", INVERSE, "--fmu", "--output", str(tmp_path / "unit.fmu")]) == 0
    assert "Hold zoh (the model's own hold is foh)" in capsys.readouterr().out


def test_the_same_model_gives_the_same_bytes(tmp_path, capsys):
    for folder in ("one", "two"):
        export("fsm_mhl.yaml", output=tmp_path / folder)
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == ["Makefile", "fsm_mhl.c", "fsm_mhl.h", "fsm_mhl_golden.h", "fsm_mhl_test.c"]
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    assert re.search(r"state \d{4} bytes, flash \d{4} bytes", capsys.readouterr().out)
    text = (tmp_path / "one" / "fsm_mhl.c").read_text()
    assert "malloc" not in text and "#include <string.h>" not in text


@pytest.mark.skipif(not shutil.which("sha256sum"), reason="sha256sum is not installed")
def test_the_header_has_the_hash_of_the_file(tmp_path):
    export("pea_hampi.yaml", output=tmp_path)
    told = subprocess.run(["sha256sum", config_path("models/pea_hampi.yaml")], capture_output=True, text=True, check=True).stdout
    assert f"pea_hampi.yaml: SHA-256 {told.split()[0]}" in (tmp_path / "pea_hampi.h").read_text()


@pytest.mark.skipif(
    not (shutil.which("arm-linux-gnueabihf-gcc") and shutil.which("qemu-arm")),
    reason="no ARM here: apt-get install gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user",
)
@pytest.mark.parametrize("case", ["mhl", "hampi, exact"])
def test_an_arm_gives_the_same_bits(case, tmp_path):
    export(*FEEDFORWARDS[case], output=tmp_path)
    told = make(tmp_path, "arm")
    assert told.count(" 0 wrong") == 2


@pytest.mark.skipif(not shutil.which("cppcheck"), reason="cppcheck is not installed: apt-get install cppcheck")
@pytest.mark.parametrize("case", ["hampi, exact", "mhl"])
def test_misra_finds_no_more_than_the_listed_deviations(case, tmp_path):
    export(*FEEDFORWARDS[case], output=tmp_path)
    make(tmp_path, "misra")


def test_a_tool_that_is_not_installed_is_left_out(tmp_path):
    export("pea_hampi.yaml", output=tmp_path)
    words = [shutil.which("make"), "-C", str(tmp_path), "arm", "misra", "ARM=arm-gcc-that-is-nowhere"]
    (tmp_path / "bin").mkdir()
    for tool in ("sh", "mkdir"):
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool))
    ended = subprocess.run(words, capture_output=True, text=True, env={"PATH": str(tmp_path / "bin")})
    assert ended.returncode == 0, ended.stderr
    assert "arm-gcc-that-is-nowhere is not installed: left out\n" in ended.stdout
    assert "cppcheck is not installed: left out\n" in ended.stdout


def test_what_cannot_be_exported_is_refused_with_the_reason(tmp_path, capsys):
    folder = str(tmp_path / "out")
    hampi = str(config_path("models/pea_hampi.yaml"))
    assert main(["export", hampi, "--kind", "hampi", "--output", folder]) == 2
    assert "ticks ahead, where a reference in real time is not known: give --causal" in capsys.readouterr().err
    noisy = Path(hampi).read_text().replace("noise:", "  - {stage: sensor_noise, rms: 0.1}\nnoise:")
    (tmp_path / "noisy.yaml").write_text(noisy)
    assert main(["export", str(tmp_path / "noisy.yaml"), "--output", folder]) == 2
    assert "draws random numbers, which belong to a simulation: leave the stage out" in capsys.readouterr().err
    (tmp_path / "other.yaml").write_text("recorder:\n  ros__parameters: {output: bag}\n")
    assert main(["export", str(tmp_path / "other.yaml"), "--output", folder]) == 2
    assert "pi_feedback: is missing" in capsys.readouterr().err
    assert not Path(folder).exists()


def test_defaults_are_the_nodes_defaults():
    """What a file of parameters leaves out is what the node takes for it."""
    pytest.importorskip("rclpy")
    from dataclasses import fields

    from hyst_control.export.controller import FaultResponse
    from hyst_control.nodes.pi_feedback import PiFeedback
    from hyst_control.nodes.signal_node.common_parameters import COMMON

    settings = {setting.name: setting.default for setting in (*COMMON, *PiFeedback.SETTINGS)}
    assert {item.name: item.default for item in fields(FaultResponse)} == {
        item.name: settings[item.name] for item in fields(FaultResponse)
    }


@pytest.mark.parametrize("form", [[], ["--ros2-control"]])
def test_a_folder_is_written_again_but_a_file_of_the_user_is_not_replaced(tmp_path, capsys, form):
    controller = tmp_path / "controller.yaml"
    controller.write_text(
        "/**:\n  ros__parameters: {rate_hz: 1000.0, axes: [x]}\npi_feedback:\n  ros__parameters: {kp: 0.3, ki: 100.0, upper: 50.0}\n",
        encoding="utf-8",
    )
    command = ["export", str(controller), "--output", str(tmp_path / "made"), *form]
    assert main(command) == 0
    made = {path.name: path.read_bytes() for path in (tmp_path / "made").iterdir()}
    assert main(command) == 0 and made == {path.name: path.read_bytes() for path in (tmp_path / "made").iterdir()}
    for name in made:
        (tmp_path / "own").mkdir(exist_ok=True)
        (tmp_path / "own" / name).write_text("all:\n", encoding="utf-8")
        assert main([*command[:3], str(tmp_path / "own"), *form]) == 2
        assert f"own/{name}: would be replaced" in capsys.readouterr().err.splitlines()[-1]
        assert [path.read_text(encoding="utf-8") for path in (tmp_path / "own").iterdir()] == ["all:\n"]
        (tmp_path / "own" / name).unlink()
