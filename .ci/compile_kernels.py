# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Let numba compile the kernels of the first commands into its cache, so that no user waits for it: `make env` runs it once."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile

from hyst_control.base.config_files import config_path
from hyst_control.cli import main

if __name__ == "__main__":
    model = str(config_path("models/pea_hampi.yaml"))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        os.chdir(folder)
        main(["simulate", model, "--excitation", "hampi_identification", "quasi_static=0.3", "--output", "record", "--quiet"])
        main(["identify", "record", "--model", "hampi", "--output", "model.yaml", "--force", "--quiet"])
