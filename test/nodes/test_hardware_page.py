"""The page on hardware: its files as they stand, run by its commands, and the model that comes of it."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.model_file import load_model, simulate
from hyst_control.records.bags.bag_reader import read_bag

pytestmark = pytest.mark.long_file

PAGE = config_path("models/pea_hampi.yaml").parents[2] / "docs" / "hardware.md"


def files() -> dict[str, str]:
    """The page's files by name."""
    return dict(re.findall(r"^\*\*([\w.]+)\*\*\n\n```\w+\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M))


def commands() -> list[list[str]]:
    """The page's commands for the newcomer's stage."""
    (text,) = re.findall(r"^```sh\n(python my_stage.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    return [shlex.split(line) for line in text.splitlines()]


PROGRAMS = {
    "python": [sys.executable],
    "pipeline": [sys.executable, "-m", "hyst_control.nodes.pipeline"],
    "hyst": [sys.executable, "-c", "import sys; from hyst_control.cli import main; sys.exit(main())"],
}


RECORDINGS = 3
"""Recordings that are made at most: beside other tests a record on the wall clock may lack so many ticks that no model comes of it."""


def test_a_node_by_the_page_alone_is_recorded_and_identified(domain, tmp_path):
    assert len(files()["my_stage.py"].strip().splitlines()) <= 30
    for number in range(RECORDINGS):
        folder = tmp_path / str(number)
        folder.mkdir()
        status, told = recorded_and_identified(folder)
        if status == 0:
            break
    assert status == 0, told
    model = load_model(folder / "stage.yaml")
    time = np.arange(200) * 0.02  # 1 Hz lies in the excited band, and low enough for a machine that is late with its ticks
    answer = simulate(model, 40.0 + 8.0 * np.sin(2 * np.pi * time)[:, None], sample_time=0.02)[100:, 0]
    gain = abs(np.exp(-2j * np.pi * time[100:]) @ (answer - answer.mean())) / 400.0
    assert gain == pytest.approx(0.12 / abs(1 + 2j * np.pi * 0.020), rel=0.05), told
    assert len(read_bag(folder / "bag").signals["applied"].time)  # the recorder has heard that the stage had no command at first
    assert json.loads((folder / "fit.json").read_text())["family"] == "linear"


def recorded_and_identified(folder: Path) -> tuple[int, str]:
    """Run the page's commands in a folder: exit status and words of the identification."""
    for name, text in files().items():
        (folder / name).write_text(text, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(PAGE.parents[1])}

    def start(words: list[str]) -> subprocess.Popen[str]:
        program, *arguments = words
        return subprocess.Popen(
            [*PROGRAMS[program], *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    stage, pipeline, identify = commands()
    running = start(stage)
    try:
        recording = start(pipeline)
        told = recording.communicate(timeout=120)[0]
        assert recording.returncode == 0 and "Traceback" not in told, told
    finally:
        running.send_signal(signal.SIGINT)
        told = running.communicate(timeout=60)[0]
    assert running.returncode == 0 and "Traceback" not in told and "failed" not in told, told
    fit = start(identify)
    told = fit.communicate(timeout=120)[0]
    return fit.returncode, told
