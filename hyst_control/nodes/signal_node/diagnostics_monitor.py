# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of all nodes of a ROS domain as lines of JSON, for programs without ROS."""

from __future__ import annotations

import json

from diagnostic_msgs.msg import DiagnosticArray

from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.run import executable


class Monitor(EndingNode):
    """Node that prints one line per status: `{"node": …, "stamp": …, "values": {…}}`, the stamp in s."""

    def __init__(self, name: str = "monitor") -> None:
        super().__init__(name)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        for status in message.status:
            print(
                json.dumps(
                    {
                        "node": status.name.rpartition(":")[0].rpartition("/")[2],
                        "stamp": stamp,
                        "values": {entry.key: entry.value for entry in status.values},
                    }
                ),
                flush=True,
            )


main = executable(Monitor)

if __name__ == "__main__":
    raise SystemExit(main())
