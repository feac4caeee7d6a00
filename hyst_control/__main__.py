# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m hyst_control`: the command line `hyst` where its script is not on the path."""

from hyst_control.processes.executables import hyst

if __name__ == "__main__":
    raise SystemExit(hyst())
