# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Mark of tests that need measured records."""

import pytest

from evaluation.reproduction.measured_data import data_folder
from hyst_control.base.errors import InputError


def needs(name):
    """Mark of tests that are skipped where the records of this name are not there."""
    try:
        absent = not data_folder(name)
    except InputError:
        absent = True
    return pytest.mark.skipif(absent, reason=f"the records of {name} are not there: set HYST_DATA")
