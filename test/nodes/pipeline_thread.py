"""Composed nodes on a thread of the test's process, beside nodes that are processes: less is to be started."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Mapping
from typing import Any

import left_over_nodes
import rclpy
from rclpy.parameter import Parameter

from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import node_class
from hyst_control.processes.node_processes import Processes


class PipelineThread:
    """Stands in for the process of composed nodes, as far as `Processes` asks."""

    def __init__(self, parameters: Mapping[str, Mapping[str, Any]], domain: int) -> None:
        self.returncode: int | None = None
        self._context, self._left_over = rclpy.Context(), left_over_nodes.destroyed()
        rclpy.init(context=self._context, domain_id=domain)
        self._left_over.__enter__()
        self._nodes = [
            node_class(name)(context=self._context, parameter_overrides=[Parameter(key, value=value) for key, value in own.items()])
            for name, own in parameters.items()
        ]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        status: int | None = 1
        try:
            status = run(self._nodes, self._context)
        except KeyboardInterrupt:
            status = 0
        finally:
            self._left_over.__exit__(None, None, None)
            rclpy.try_shutdown(context=self._context)
            self.returncode = status

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise subprocess.TimeoutExpired("pipeline", timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Whatever its number: the thread that hears signals tells the run of them in this way."""
        if interrupts._receiver is not None:
            interrupts._receiver()


class ProcessesBesideThread(Processes):
    """Nodes as processes, and the composed ones here."""

    def compose(self, parameters: Mapping[str, Mapping[str, Any]], name: str = "pipeline") -> Any:
        self.running[name] = PipelineThread(parameters, int(self._environment["ROS_DOMAIN_ID"]))  # type: ignore[assignment]
        return self.running[name]
