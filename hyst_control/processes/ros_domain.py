"""A ROS domain of one's own: runs side by side on a machine must not hear each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from hyst_control.errors import InputError

DOMAINS = range(1, 102)  # above 101 the ports of a domain reach into the ephemeral ones of Linux

_held: dict[int, int] = {}


def lock_of(domain: int) -> tuple[int, ...]:
    """The open file that locks a domain of this process, for its children to inherit: they may outlive it; empty for others."""
    return (_held[domain],) if domain in _held else ()


@contextmanager
def own_domain() -> Iterator[int]:
    """A domain id that no other run of this package on this machine holds, for as long as the context or a child's process lasts."""
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
    raise InputError(f"ROS domains: all of {DOMAINS.start} to {DOMAINS.stop - 1} are in use: wait for another run to end")
