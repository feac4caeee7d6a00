# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Result of a command: the interface that all share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class CommandResult(Protocol):
    """Result of a command: its text on the terminal, and its document for `--json`."""

    def text(self) -> str:
        """Lines for the terminal."""

    def document(self) -> Mapping[str, object]:
        """Numbers, texts and lists for JSON."""
