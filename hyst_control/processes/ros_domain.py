# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""ROS domain of a run, because runs side by side on one machine must not receive each other's messages."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from hyst_control.base.errors import InputError

DOMAINS = range(1, 102)  # above 101 the ports of a domain reach into the ephemeral ones of Linux

_held: dict[int, int] = {}


def lock_of(domain: int) -> tuple[int, ...]:
    """Open file that locks a domain, for child processes to inherit because they may outlive this process."""
    return (_held[domain],) if domain in _held else ()


@contextmanager
def own_domain() -> Iterator[int]:
    """Lock a domain that no other run of this package on this machine uses, until the context and all child processes have ended."""
    import fcntl  # of Linux and macOS only, as nodes are

    for domain in DOMAINS:
        path = os.path.join(tempfile.gettempdir(), f"hyst_control_{os.getuid()}_domain_{domain}.lock")
        handle = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        _held[domain] = handle
        try:
            yield domain
        finally:
            del _held[domain]
            os.close(handle)
        return
    raise InputError(f"ROS domains: all of {DOMAINS.start} to {DOMAINS.stop - 1} are in use: wait until another run has ended")
