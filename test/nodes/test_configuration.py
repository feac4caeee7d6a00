"""The shipped parameter files: the nodes run with them as they stand."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import yaml
from loop_case import recorded
from scipy.special import betainc

from hyst_control.base.config_files import config_folders, config_path
from hyst_control.base.errors import InputError


def test_pipeline_runs_with_the_lockstep_file(tmp_path, domain):
    count = 400
    document = yaml.safe_load(config_path("nodes/lockstep.yaml").read_text())
    for node in ("plant", "recorder"):
        document[f"/**/{node}"]["ros__parameters"]["ticks"] = count
    file = tmp_path / "parameters.yaml"
    file.write_text(yaml.safe_dump(document))
    ended = subprocess.run(
        [sys.executable, "-m", "hyst_control.nodes.pipeline", "--ros-args", "--params-file", str(file)],
        cwd=tmp_path,
        env=environment_with_source(),
        timeout=120,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    rows = recorded(tmp_path / "bag")
    time = np.arange(count) / 20000.0
    ramp = betainc(3, 3, np.arange(1, count + 1) / 2000)  # from rest at 0
    np.testing.assert_allclose(rows["reference"][:, 1], ramp * (3.0 + 2.0 * np.sin(2 * np.pi * 10.0 * time)), atol=1e-9)
    np.testing.assert_allclose(rows["feedforward"][:, 1], 10.0 * rows["reference"][:, 1], atol=1e-9)
    assert all(len(signal) == count for signal in rows.values())


def environment_with_source():
    return {**os.environ, "PYTHONPATH": str(config_folders()[0].parent)}


def test_pipeline_refuses_a_node_it_does_not_know():
    ended = subprocess.run(
        [sys.executable, "-m", "hyst_control.nodes.pipeline", "plnt"], timeout=60, capture_output=True, text=True
    )
    assert ended.returncode == 2 and "'plnt' is not a node" in ended.stderr and len(ended.stderr.splitlines()) == 1


def test_every_shipped_file_is_found_and_a_missing_one_is_named():
    assert config_path("nodes/timer.yaml").is_file()
    with pytest.raises(InputError, match="lockstep.yaml"):
        config_path("nodes/none.yaml")
