# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Dask clusters as executors: one that runs somewhere, or one on this computer for as long as the work takes."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from hyst_control.base import progress
from hyst_control.base.errors import InputError

LOCAL = "local"
LOOPBACK = "127.0.0.1"
CONNECT_TIMEOUT = 20.0  # Seconds that a scheduler has to answer
LOOK_AGAIN = 3.0  # Seconds after which the workers are counted again


@contextmanager
def cluster_executor(address: str, count: int) -> Iterator[tuple[Any, Callable[[], int]]]:
    """Connect to a Dask scheduler, or start one."""
    try:
        from distributed import Client, LocalCluster
    except ModuleNotFoundError:
        raise InputError("--cluster: distributed is not installed: pip install 'hyst_control[fleet]'") from None
    logging.getLogger("distributed").setLevel(logging.ERROR)  # what it has to say arrives as exceptions
    with ExitStack() as stack:
        try:
            if address == LOCAL:
                cluster: object = stack.enter_context(
                    LocalCluster(  # type: ignore[no-untyped-call]
                        n_workers=count,
                        threads_per_worker=1,
                        host=LOOPBACK,
                        dashboard_address=f"{LOOPBACK}:0",
                        silence_logs=logging.ERROR,
                    )
                )
                place = {"address": cluster}
            else:
                place = {"scheduler_file" if os.path.exists(address) else "address": address}
            client = stack.enter_context(Client(**place, timeout=CONNECT_TIMEOUT))  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:  # a timeout is an OSError
            raise InputError(
                f"--cluster {address}: no scheduler answers ({error}): start dask scheduler, or check the address"
            ) from None
        progress.step(f"Dask dashboard at {client.dashboard_link}")
        yield stack.enter_context(client.get_executor(pure=False)), _Slots(client).count


class _Slots:
    """Jobs that the workers of a cluster compute at the same time, looked up again every few seconds."""

    def __init__(self, client: Any) -> None:
        self._client, self._until, self._count = client, -math.inf, 1

    def count(self) -> int:
        """One a thread of every worker; at least one, for whom the first worker finds work."""
        if time.monotonic() > self._until:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            self._count = max(sum(worker["nthreads"] for worker in workers), 1)
            self._until = time.monotonic() + LOOK_AGAIN
        return self._count
