"""A ROS domain of one's own: runs side by side on a machine must not hear each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from hyst_control.errors import InputError

DOMAINS = range(1, 102)  # above 101 the ports of a domain reach into the ephemeral ones of Linux


@contextmanager
def own_domain() -> Iterator[int]:
    """A domain id that no other run of this package on this machine holds, for as long as the context lasts."""
    for domain in DOMAINS:
        path = os.path.join(tempfile.gettempdir(), f"hyst_control_{os.getuid()}_domain_{domain}.lock")
        handle = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            yield domain
        finally:
            os.close(handle)
        return
    raise InputError(f"ROS domains: all of {DOMAINS.start} to {DOMAINS.stop - 1} are in use: wait for another run to end")
