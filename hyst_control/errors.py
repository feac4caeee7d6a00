"""The error of every unusable input, shown to the user as one clear line."""

from __future__ import annotations


class InputError(ValueError):
    """Unusable input: what is wrong, where, and the remedy, in one line; `hyst` prints it and exits with status 2."""

    def __init__(self, text: str) -> None:
        super().__init__(" ".join(part for part in str(text).splitlines() if part))  # a name out of a file may hold a line break


class WorkerLost(InputError):
    """A process that computed was killed from outside; reported like an unusable input, since the program cannot correct it."""
