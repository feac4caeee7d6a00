"""One wrapper for readers of foreign formats: whatever they raise on damaged input ends in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hyst_control.base.errors import InputError


@contextmanager
def foreign_reader(where: str | Path, what: str, remedy: str) -> Iterator[None]:
    """Turn every exception of a reader into an `InputError`.

    Readers of other formats show damage as anything: a bad length is a `MemoryError`, a bad type an `AttributeError`, and decompressors
    have exceptions of their own. Only what is no `Exception` (an interrupt) passes.
    """
    try:
        yield
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{where}: does not fit in memory, or is damaged: {remedy}") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read as {what} ({error.strerror or first_line(error)}): {remedy}") from None
    except Exception as error:  # see above
        raise InputError(f"{where}: cannot be read as {what} ({first_line(error)}): {remedy}") from None


def first_line(error: BaseException) -> str:
    """First line of the text of `error`, or the name of its type where it has no text."""
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
