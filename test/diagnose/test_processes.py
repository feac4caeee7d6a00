# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A diagnosis in several processes is that in one, digit by digit, and a record that is refused is refused in both."""

import subprocess
import sys

PROGRAM = """
import json, os
os.sched_getaffinity = lambda process: {0, 1}
import numpy as np
from hyst_control.base.config_files import config_path
from hyst_control.base.parallel import compute_serially
from hyst_control.diagnose.workflow import diagnose_records
from hyst_control.model_file import load_model, simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal

forks = []
os.register_at_fork(after_in_parent=lambda: forks.append(1))
model = load_model(config_path("models/pea_hampi.yaml"))
command = build({"signal": "diagnostic", "lowest": 0.0, "highest": 50.0, "duration": 0.3}, model.sample_time)
measured = 1.2 * simulate(model, command) + 0.003 * np.random.default_rng(0).normal(size=command.shape)
time = np.arange(len(command)) * model.sample_time

def told(measurement):
    signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, measurement, ("x",), "um")}
    return json.dumps(diagnose_records([Record(signals, "made")], model).document)

limited = simulate(model, np.minimum(command, 42.0)) + 0.003 * np.random.default_rng(1).normal(size=command.shape)
records = measured, limited, -measured
beside = [told(record) for record in records]
assert len(forks) >= 5, forks
compute_serially()
del forks[:]
assert [told(record) for record in records] == beside and not forks
*found, refused = map(json.loads, beside)
print([[effect["name"] for effect in document["effects"]] for document in found], refused["reasons"])
"""


def test_processes_give_the_document_of_one():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "[['gain'], ['saturation']] ['invalid_record', 'sign_turned']\n", done.stderr
