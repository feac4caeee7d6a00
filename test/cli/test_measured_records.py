# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on every measured record: each ends as it should, and no warning of numpy reaches the terminal.

The suite's warnings are errors (`pyproject.toml`).
"""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.cli import main

ONE = "command=1[V],measurement={}"
THREE = "command=1+2+3[V],measurement=4+5+6[um]"
RECORDS = [
    ("pea_p885/Model_Vi_Do.dat", ONE.format("5[um]"), 200, "5:", "foh"),
    ("pea_p885/Test_Vi_Do_Di.dat", ONE.format("5[um]"), 200, "5:", "foh"),
    ("bouc_wen/multisine_train.npy", ONE.format("2[m]"), 750, "0:", "foh"),
    ("bouc_wen/multisine_test.npy", ONE.format("2[m]"), 750, "0:", "foh"),
    ("bouc_wen/sinesweep_test.npy", ONE.format("2[m]"), 750, "0:", "foh"),
    *((f"fsm_cubespec/{level}mV_train.npy", THREE, 6400, "0:", "zoh") for level in (100, 200, 300)),
]


def recording(folder, name, tmp_path):
    """The record's file; of the mirror a table of the first period of one realization."""
    if not name.startswith("fsm_cubespec"):
        return folder / name
    kind, file = name.split("/")
    command, measurement = (np.load(folder / kind / f"{letter}_{file}")[:, :, :1, 0] for letter in "uy")
    path = tmp_path / file
    np.save(path, np.hstack([rows.transpose(2, 0, 1).reshape(-1, 3) for rows in (command, 1e6 * measurement)]))
    return path


@pytest.mark.parametrize("name, columns, rate, rows, hold", RECORDS, ids=[name for name, *_ in RECORDS])
def test_a_record_is_imported_identified_and_validated_without_a_warning(
    measured_data, tmp_path, capfd, name, columns, rate, rows, hold
):
    bag, model = str(tmp_path / "bag"), str(tmp_path / "model.yaml")
    source = str(recording(measured_data, name, tmp_path))
    assert main(["import", source, "--output", bag, "--columns", columns, "--rate", str(rate), "--rows", rows, "--hold", hold]) == 0
    assert main(["identify", bag, "--model", "pi", "--operators", "6", "--output", model, "--force"]) == 0
    assert main(["validate", model, bag]) == 0
    said = capfd.readouterr()
    assert "arning" not in said.out + said.err and "Traceback" not in said.err
