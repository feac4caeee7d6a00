# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Starting and ending of nodes as processes, without ROS in the calling process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.processes import environment
from hyst_control.processes.node_list import NODES
from hyst_control.processes.ros_domain import lock_of


class Processes:
    """Nodes as processes on one ROS domain; all are ended when the context ends."""

    def __init__(self, folder: Path, domain: int, namespace: str = "") -> None:
        self.folder, self.namespace = Path(folder), namespace
        self.folder.mkdir(parents=True, exist_ok=True)
        environment.prepare()
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(self.folder), "PYTHONUNBUFFERED": "1"}
        self._lock = lock_of(domain)
        self._lifeline = os.pipe()  # nodes end with this process, also when it is killed
        self._environment[environment.LIFELINE] = str(self._lifeline[0])
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, node: str, parameters: Mapping[str, Any], name: str | None = None) -> subprocess.Popen[bytes]:
        """Start an executable with its parameters; its output goes to `name`.log."""
        name = name or node
        file = self._write(name, {"/**": parameters})
        return self.run(
            name, NODES[node].module, "--ros-args", "-r", f"__node:={name}", *self._remaps(), "--params-file", str(file)
        )

    def compose(self, parameters: Mapping[str, Mapping[str, Any]]) -> subprocess.Popen[bytes]:
        """Start several nodes as one process."""
        file = self._write("pipeline", {f"/**/{node}": own for node, own in parameters.items()})
        return self.run(
            "pipeline", NODES["pipeline"].module, *parameters, "--ros-args", *self._remaps(), "--params-file", str(file)
        )

    def run(self, name: str, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start a module as a process on the domain; its output goes to `name`.log."""
        return self.execute(name, [sys.executable, "-m", module, *arguments])

    def execute(self, name: str, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a program with the environment of the nodes; its output goes to `name`.log."""
        with open(self.log(name), "ab") as log:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(*self._lock, self._lifeline[0]),
                start_new_session=True,
            )  # `stop` passes a Ctrl-C on, once
        self.running[name] = process
        return process

    def _write(self, name: str, parameters: Mapping[str, Mapping[str, Any]]) -> Path:
        file = self.folder / f"{name}.yaml"
        document = {node: {"ros__parameters": dict(own)} for node, own in parameters.items()}
        file.write_text(json.dumps(document, indent=1), encoding="utf-8")  # quoted: ROS takes a bare y for a boolean
        return file

    def _remaps(self) -> list[str]:
        return ["-r", f"__ns:={self.namespace}"] if self.namespace else []

    def log(self, name: str) -> Path:
        """File with the output of a process."""
        return self.folder / f"{name}.log"

    def wait(self, *names: str, timeout: float) -> None:
        """Wait until these nodes have ended by themselves."""
        end = time.monotonic() + timeout
        while any(self.running[name].poll() is None for name in names):
            self.check()
            if time.monotonic() > end:
                raise TimeoutError(f"{', '.join(names)}: still running after {timeout:g} s; the logs are in {self.folder}")
            with suppress(subprocess.TimeoutExpired, StopIteration):
                next(self.running[name] for name in names if self.running[name].poll() is None).wait(0.1)
        self.check()

    def check(self) -> None:
        """Raise `InputError` when a node has failed."""
        for name, process in self.running.items():
            if process.poll():
                lines = self.log(name).read_text(errors="replace").strip().splitlines()
                raise InputError(f"{name} ended with status {process.returncode}: {lines[-1] if lines else 'no output'}")

    def stop(self) -> dict[str, int]:
        """Interrupt the running processes and wait 10 s for them, then kill them."""
        for process in self.running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        end = time.monotonic() + 10.0
        for process in self.running.values():
            try:
                process.wait(max(end - time.monotonic(), 0.01))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        return {name: process.returncode for name, process in self.running.items()}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()
        for end in self._lifeline:
            os.close(end)
