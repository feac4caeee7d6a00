# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Branch coverage of the exported controller by gcov: both outcomes of every condition, those joined by && and || each for itself."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from test_controller import CHOICES, LAWS, RATE, rows
from test_odd_numbers import odd_rows

from hyst_control.base.config_files import config_path
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.export.c_source import Program, header, source
from hyst_control.export.controller import Controller, FaultResponse
from hyst_control.model_file import load_model

MAIN = """
#include "loop.h"
#include <math.h>
#include <stdio.h>

int main(void)
{
    static loop_state state;
    double in[LOOP_INPUTS], out[LOOP_OUTPUTS];
    loop_init(&state);
    for (int row = 0; fread(in, sizeof in, 1, stdin) == 1; row++) {
        if (row >= SPOILED && row % 7 == 0) {
            state.chain.command[0] = NAN;
            state.chain.saturated = 1000000000;
        }
        loop_block(&state, in, out, 1);
        (void)fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""
OWN = ("larger_of", "smaller_of", "clamped_command", "ramped_command", "all_finite")
SPOILED = 2500
"""Row from which on the state is damaged again and again, as by bits that flip in memory: no last command, and a counter at its end."""
FARTHEST = 1.79e308
Branch = tuple[str, int, int]
"""Text of the line, which line of such a text it is, and which branch of the line."""


def variants():
    """Controllers of every choice that changes the C, each with the rows of `test_controller`."""
    for law, recovery, axes, axis_fault in CHOICES:
        response = FaultResponse((2.0,), 3000.0, axis_fault, 0.005, recovery, 0.01, -10.0, 30.0, 0.005)
        learned = np.random.default_rng(3).normal(0.0, 2.0, (37, axes)) if recovery == "manual" else None
        table = rows(4, 3000, axes)
        yield Controller(LAWS[law], axes, response, None, learned), np.concatenate([table, odd_rows(1, table, 1e308)])
    far = FaultResponse(
        (2.0,), 3000.0, measurement_lower=-FARTHEST, measurement_upper=FARTHEST, recovery_time=1e-4, frozen_time=0.0
    )
    for law in LAWS:
        yield Controller(LAWS[law], 1, far), odd_rows(2, rows(5, 3000, 1), FARTHEST)
    # The feedforward alone is at the end of double: its sum with the correction is finite, what is cut off of it is not.
    steep = PI(1.0, 1e-3, 1 / RATE, 0.0, 50.0, tracking_time=1 / RATE)
    yield Controller(steep, 1, far, None, np.full((1, 1), FARTHEST)), np.array([[0.0, 0.0, 1.0]] * 3 + [[0.9e308, 0.0, 1.0]] * 3)
    feedforward = build_compensator(load_model(config_path("models/pea_hampi.yaml")), "hampi", sample_time=1 / RATE)
    late = rows(4, 3000, 1)
    late[:9, 0] = np.nan
    yield Controller(LAWS["integral"], 1, FaultResponse(frozen_time=0.0), feedforward), late
    watched = FaultResponse((2.0,), 3000.0, recovery="manual", measurement_lower=-30.0, measurement_upper=30.0, frozen_time=0.005)
    for gain in (0.1, 2.0):  # of which the one lets the stage move less, the other more than the measurement's range
        loop = Controller(PI(0.1 / gain, 100.0 / gain, 1 / RATE, 0.0, 50.0, 2e5), 1, watched)
        yield loop, turning(loop, gain)
    # A loop too slow to ask for an answer, before a measurement that stays.
    slow = np.tile([4.0, 3.0, 1.0], (1000, 1))
    slow[:10, 1] = np.arange(10.0)
    yield Controller(PI(0.0, 0.1, 1 / RATE, 0.0, 50.0, 2e5), 1, watched), slow


def turning(controller: Controller, gain: float) -> np.ndarray:
    """Rows of a loop around a stage of this gain, um/V, whose sensor's sign turns half way."""
    table, position = np.ones((SPOILED, 3)), 0.0
    table[:, 0] = (1.0 - np.cos(2.0 * np.pi * 50.0 * np.arange(SPOILED) / RATE)) * min(20.0 * gain, 10.0)
    controller.settle(table[0])
    for row, values in enumerate(table):
        values[1] = position if row < SPOILED // 2 else -position
        position += 0.2 * (gain * controller.process(values[None])[0, 0] - position)
    controller.settle(table[0])
    return table


def taken(controller: Controller, table: np.ndarray, folder: Path) -> Counter[Branch]:
    """How often each branch was taken over the rows, whose outputs are Python's to the last bit, and commands within their limits."""
    axes = ("x", "y")[: controller.axes]
    program = Program("loop", controller.c_code(), len(axes), *controller.slots(axes, "um"), 1 / RATE, ())
    for name, text in (("loop.h", header(program)), ("loop.c", source(program)), ("main.c", MAIN)):
        (folder / name).write_text(text)
    build = [
        "gcc",
        "-std=c99",
        "-O0",
        "--coverage",
        f"-DSPOILED={SPOILED}",
        "-ffp-contract=off",
        "loop.c",
        "main.c",
        "-lm",
        "-o",
        "run",
    ]
    subprocess.run(build, cwd=folder, check=True)
    found = subprocess.run(["./run"], cwd=folder, input=np.ascontiguousarray(table).tobytes(), capture_output=True, check=True)
    outputs = np.frombuffer(found.stdout).reshape(len(table), -1)
    np.testing.assert_array_equal(outputs[:SPOILED], controller.process(table[:SPOILED]))
    commands = outputs[:, : controller.axes]
    assert np.all((commands >= controller.pi.lower) & (commands <= controller.pi.upper))
    told = subprocess.run(
        ["gcov", "-b", "-c", "--json-format", "--stdout", "run-loop.gcda"], cwd=folder, capture_output=True, check=True
    )
    [file] = [each for each in json.loads(told.stdout)["files"] if each["file"] == "loop.c"]
    text, seen, counts = (folder / "loop.c").read_text().splitlines(), Counter[str](), Counter[Branch]()
    for line in sorted(file["lines"], key=lambda line: line["line_number"]):
        function, words = line.get("function_name", ""), text[line["line_number"] - 1].strip()
        if function.endswith(("_controller_step", "_controller_settle")) or function in OWN:
            seen[words] += 1
            for number, branch in enumerate(line["branches"]):
                counts[words, seen[words], number] += branch["count"]
    return counts


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.skipif(not shutil.which("gcov") or not shutil.which("gcc"), reason="gcc with gcov is not installed")
def test_every_branch_of_the_exported_controller_is_taken(tmp_path):
    total: Counter[Branch] = Counter()
    for number, (controller, table) in enumerate(variants()):
        folder = tmp_path / str(number)
        folder.mkdir()
        for branch, count in taken(controller, table, folder).items():
            total[branch] += count
    missed = [branch for branch, count in total.items() if not count]
    print(f"exported controller: {len(total) - len(missed)} of {len(total)} branches taken")
    assert not missed, "\n".join(map(str, missed))
