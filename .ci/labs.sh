#!/usr/bin/env bash
# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
# Tests that need laboratories' software (bluesky, EPICS, Foxglove) or foreign simulators (MuJoCo, FMPy), with these packages in a folder
# beside .venv: users do not install them. A test that is skipped here fails the part.
set -euo pipefail
cd "$(dirname "$0")/.."
labs=.venv-labs
stamp=$labs/.ready-$(cat requirements-labs.txt .venv/.ready-* | sha256sum | cut -c1-16)
if [ ! -f "$stamp" ]; then
    rm -rf "$labs"
    .venv/bin/python -m pip install --quiet --quiet --disable-pip-version-check --no-deps --require-hashes --target "$labs" -r requirements-labs.txt
    touch "$labs/COLCON_IGNORE" "$stamp"
fi
export PYTHONPATH=$PWD/$labs ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
.venv/bin/python -m pytest -q -rs test/labs test/examples/test_simulators.py test/export/test_fmu.py "$@" | tee "$labs/tests.txt"
if grep -q '^SKIPPED' "$labs/tests.txt"; then
    echo "tests were skipped although everything is installed"
    exit 1
fi
