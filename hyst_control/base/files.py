# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Opening files to write: a reader never meets half of one, and what is no plain file is written through.

A plain file is written under a temporary name beside it and renamed. A device, a FIFO or a socket cannot be replaced without destroying
it, and a symbolic link stands for what it names: those are written through.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import first_line

LINKS = 40  # Symbolic links that are followed one after the other, as the kernel does
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def refusal(error: OSError, path: object, remedy: str) -> str:
    """Words for what the system refused at a path ("" where none is known), and the remedy: room, where there is none for it."""
    if error.errno in NO_ROOM:
        return f"no room for {path or 'the output'} ({error.strerror}): free space or choose another folder"
    return f"{path}: {error.strerror or error}: {remedy}".removeprefix(": ")


def check_writable(path: str | Path) -> None:
    """Check that a file can be written at `path`, as far as that shows beforehand. Raises `InputError` if not."""
    try:
        target = _target(path)
        mode = _mode(target)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}: choose another name") from None
    if mode is not None and stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a directory: give the name of a file")
    if mode is not None and (not stat.S_ISREG(mode) or _of_process(target)):
        if not os.access(target, os.W_OK):
            raise InputError(f"{path}: cannot be written: choose another name")
        return
    if not target.parent.is_dir() or not os.access(target.parent, os.W_OK):
        raise InputError(f"{path}: its folder does not exist or cannot be written: create it first")


def check_outputs(outputs: Mapping[str, str | Path | None], inputs: Iterable[str | Path | None] = ()) -> None:
    """Refuse outputs that would destroy what is read, or each other, before anything is computed."""
    # inputs: what is read: files and folders. What does not exist is left out
    read = [Path(path) for path in inputs if path is not None and os.path.lexists(path)]
    named: dict[Path, str] = {}
    for name, path in outputs.items():
        if path is None or path == "-":
            continue
        real = Path(os.path.realpath(path))
        if os.path.lexists(real) and not real.is_file() and not real.is_dir():
            continue  # a device or FIFO takes any number of them
        for source in read:
            own = Path(os.path.realpath(source))
            if real == own or (real.exists() and own.exists() and os.path.samefile(real, own)):
                raise InputError(f"{name} {path}: is read as well: choose another name")
            if own.is_dir() and own in real.parents:
                raise InputError(f"{name} {path}: lies within {source}, which is read: choose another place")
        if real in named:
            raise InputError(f"{name} {path}: is {named[real]} as well: give every output a name of its own")
        named[real] = name


@contextmanager
def replacing(path: str | Path, private: bool = False) -> Iterator[BinaryIO]:
    """Open `path` to write a file that appears under its name only when the block has ended without an exception.

    A new file gets the permissions that the user's umask leaves, one that was there keeps its own; a private one is its owner's alone.
    Devices, FIFOs and what a symbolic link names are written through. Raises `InputError` where the file cannot be written.
    """
    try:
        target = _target(path)
        mode = _mode(target)
        if mode is not None and stat.S_ISDIR(mode):
            raise InputError(f"{path}: is a directory: give the name of a file")
        if (mode is not None and not stat.S_ISREG(mode)) or _of_process(target):
            with _through(target) as device:
                yield device
            return
        part = target.with_name(f".{target.name[:200]}-{secrets.token_hex(6)}.part")
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o666)
    except OSError as error:
        raise InputError(refusal(error, path, "choose a folder that exists and can be written")) from None
    try:
        with os.fdopen(handle, "wb") as file:
            if mode is not None and not private and hasattr(os, "fchmod"):
                os.fchmod(file.fileno(), stat.S_IMODE(mode))
            yield file
        os.replace(part, target)
    except OSError as error:
        raise InputError(refusal(error, path, "choose a file name that can be written")) from None
    finally:
        with suppress(FileNotFoundError):
            os.unlink(part)


@contextmanager
def appearing(path: Path) -> Iterator[Path]:
    """Provide a place for a new file or folder, which appears as `path` only when the block has ended without an exception."""
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already: choose another name or remove it")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        temporary = TemporaryDirectory(dir=path.parent, prefix=f".{path.name[:200]}-")
    except OSError as error:  # which would name the temporary folder
        raise InputError(refusal(error, path, "choose a folder that can be written")) from None
    with temporary as place:
        part = Path(place) / path.name
        yield part
        part.rename(path)


def read_json(path: str | Path) -> dict[str, Any]:
    """JSON object in the file at `path`. Raises `InputError` where the file cannot be read, or holds anything else."""
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or first_line(error)
        raise InputError(f"{path}: cannot be read as JSON ({reason}): remove it, or choose another one") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: must hold a JSON object, holds {type(document).__name__}: remove it, or choose another one")
    return document


def write_text(path: str | Path, text: str, private: bool = False) -> None:
    """Write `text` to the file at `path` completely or not at all, where `private` for its owner alone; `InputError` when it cannot be."""
    data = text.encode("utf-8", "backslashreplace")  # a file's name may hold bytes that are no text
    with replacing(path, private) as file:
        file.write(data)


def write_texts(folder: str | Path, texts: Mapping[str, str], mark: str) -> list[Path]:
    """Write files of these names into a folder, where it is new all of them or none; `InputError` when that cannot be.

    A file that is there is replaced only where it holds `mark`, which every text must hold: another one is somebody's own.
    """
    folder = Path(folder)
    new = not folder.exists()
    for path in (folder / name for name in texts):
        if path.is_file() and mark.encode() not in path.read_bytes():
            raise InputError(f"{path}: would be replaced, but does not say {mark!r}: choose another folder, or move the file away")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}: choose another folder") from None
    try:
        with ExitStack() as files:  # no file gets its name before the last one is written
            for name, text in texts.items():
                try:
                    file = files.enter_context(replacing(folder / name))
                    file.write(text.encode("utf-8", "backslashreplace"))
                    file.flush()
                except OSError as error:
                    raise InputError(refusal(error, folder / name, "choose a folder that can be written")) from None
    except BaseException:
        if new:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return [folder / name for name in texts]


def write_json(path: str | Path, document: Any, private: bool = False) -> None:
    """Write a JSON `document` at `path`, `private` or not as `write_text` does; NaN and infinity are refused with a `ValueError`."""
    write_text(path, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n", private)


def _target(path: str | Path) -> Path:
    """Target of a path: its symbolic links followed, but not those of /proc, which name a process's open files."""
    target = Path(path)
    for _ in range(LINKS):
        if _of_process(target) or not target.is_symlink():
            return target
        target = target.parent / os.readlink(target)
    raise OSError(0, "too many symbolic links")


def _of_process(path: Path) -> bool:
    """True for a path such as /dev/stdout, which names an open file of a process: no other file can take its place."""
    return Path("/proc") in path.parents or Path(os.path.realpath(path.parent)).is_relative_to("/proc")


def _through(target: Path) -> BinaryIO:
    """A device, a FIFO or an open file of a process; of this process the file itself, behind what was printed to it."""
    if os.path.realpath(target.parent) == f"/proc/{os.getpid()}/fd":
        sys.stdout.flush()
        return os.fdopen(os.dup(int(target.name)), "wb")
    return open(target, "ab")  # what a shell redirected is not cut off


def _mode(path: Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
