# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Compilers and a cache of their own for the tests of the exported C."""

from __future__ import annotations

import shutil

import pytest

from hyst_control.export.compiled import COMPILERS


@pytest.fixture(autouse=True, scope="session")
def compiled_cache(run_folder):
    """Libraries go to a folder of this run: what one worker has compiled serves the others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(run_folder / "compiled"))
        yield


def pytest_collection_modifyitems(items):
    if not any(map(shutil.which, COMPILERS)):
        for item in items:
            if "test/export" in item.path.as_posix():
                item.add_marker(pytest.mark.skip(reason=f"no C compiler: none of {', '.join(COMPILERS)} is installed"))
