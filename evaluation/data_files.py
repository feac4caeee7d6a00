# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the evaluation that stand in YAML files beside the code."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hyst_control.base.yaml_files import read_yaml


def table_file(name: str) -> Any:
    """Content of a file, by its path below this folder; lists become tuples."""
    return frozen(read_yaml(Path(__file__).parent / name))


def frozen(value: Any) -> Any:
    """A value of JSON types with tuples in place of its lists."""
    if isinstance(value, Mapping):
        return {key: frozen(item) for key, item in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list) else value
