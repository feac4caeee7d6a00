# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that tests share: a ROS domain and context of their own, and the measured data where it is there."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the package does, which numpy here comes before: the workers have the cores

import browser as browsers
import left_over_nodes
import numpy as np
import pytest

from hyst_control.base.parallel import compute_serially
from hyst_control.processes import environment
from hyst_control.processes.ros_domain import own_domain

environment.prepare()
# A shell ignores interrupts in what it runs in the background, and so would the commands whose interrupts are tested.
signal.signal(signal.SIGINT, signal.default_int_handler)
if "PYTEST_XDIST_WORKER" in os.environ:  # a worker a core: forks of each would cost a third of the processor time of a diagnosis
    compute_serially()
ROOT = Path(__file__).resolve().parent.parent
collect_ignore_glob = [] if find_spec("rclpy") else ["nodes/*"]


LONG, SHORT = 30.0, 4.0
"""About what a file marked `long_file` takes, and any other, s."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files marked `long_file` come first: begun last, one of them would keep one worker busy while the others have nothing to do.

    They take turns by folder: files of one folder, begun at once, would have each worker compile the same kernels. Tests of nodes
    mostly wait: their files are spread among those that compute, so that there is always something to compute.
    """
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    seconds = {path: LONG if file[0].get_closest_marker("long_file") else SHORT for path, file in files.items()}
    seen: Counter[tuple[Path, float]] = Counter()
    turns: dict[Path, int] = {}
    for path in files:
        seen[path.parent, seconds[path]] += 1
        turns[path] = seen[path.parent, seconds[path]]
    begins: dict[Path, float] = {}  # as a share of the time of all files of its kind
    for kind in (True, False):
        of_kind = [path for path in files if ("nodes" in path.parts) is kind]
        own = sorted(of_kind, key=lambda path: (seconds[path], -turns[path], path), reverse=True)
        times = np.cumsum([0.0] + [seconds[path] for path in own])
        begins |= dict(zip(own, times[:-1] / times[-1]))
    items[:] = [item for path in sorted(files, key=begins.__getitem__) for item in files[path]]


def pytest_collection_finish() -> None:
    """Spare the garbage collector the modules and the thousands of tests, which stay to the end."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def domain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test or run uses meanwhile; logs go to the test's folder."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    with own_domain() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture
def ros_context(domain: int) -> Iterator[object]:
    """A private rclpy context on that domain; nodes that a test leaves over go with it."""
    import rclpy

    with left_over_nodes.destroyed():
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        try:
            yield context
        finally:
            rclpy.try_shutdown(context=context)


@pytest.fixture(scope="module")
def browser() -> Iterator[Callable[..., browsers.Seen]]:
    """Looks at a page with a real browser: path of the page, width in pixels, color scheme; skipped where there is none."""
    if reason := browsers.missing():
        pytest.skip(reason)
    with browsers.chromium() as running:
        yield lambda path, width, scheme="light", **how: browsers.look_at(running, path, width, scheme, **how)


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of this run that all of its workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder with measured records."""
    return _shared("data", "HYST_DATA")


@pytest.fixture
def conformance() -> Path:
    """The folder with records that every implementation of the published models must reproduce."""
    return _shared("conformance", "HYST_CONFORMANCE")


def _shared(name: str, variable: str) -> Path:
    folder = Path(os.environ.get(variable) or ROOT.parent / "shared" / name)
    if not folder.is_dir():
        pytest.skip(f"no folder {name}: set {variable} to it")
    return folder
