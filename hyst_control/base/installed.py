# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Version of this package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def installed_version(otherwise: str = "not installed") -> str:
    """Version of this package, or another text where it runs from its folder without having been installed."""
    try:
        return version("hyst_control")
    except PackageNotFoundError:
        return otherwise
