# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The error of every unusable input, shown to the user as one clear line, and the kind of note that tells of a loss."""

from __future__ import annotations

LONGEST = 2000  # Characters of a line; a value out of a file may be as long as the file


class InputError(ValueError):
    """Unusable input: what is wrong, where, and the remedy, in one line; `hyst` prints it and exits with status 2."""

    def __init__(self, text: str) -> None:
        line = " ".join(part for part in str(text).splitlines() if part)  # a name out of a file may hold a line break
        super().__init__(line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} … {line[-LONGEST // 2 :]}")


class WorkerLost(InputError):
    """A process that computed was killed from outside; reported like an unusable input, since the program cannot correct it."""


class Loss(str):
    """A note on data that are lost or damaged; other notes say how the rest was read."""

    __slots__ = ()
