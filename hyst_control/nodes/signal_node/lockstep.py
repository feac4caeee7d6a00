"""Schedule in which a node advances whenever its inputs allow it; the plant is the clock.

Rows have the ticks 0, 1, 2, … and each is used once. Lost rows are requested by repeating the newest measurement: a node that receives
rows it already has repeats its own newest rows.
"""

from __future__ import annotations

import time
from typing import Any

from hyst_control.nodes.signal_node.signal_ports import Input, Schedule
from hyst_control.records.stream.signal_rows import Missing, Receipt, Wait, waits


class Lockstep(Schedule):
    """Advances the node with every message, as it comes."""

    pace = "lockstep"

    @property
    def ticks(self) -> int:
        return max((source.rows.end or 0 for source in self._node.inputs), default=0)

    def resume(self) -> None:
        self._node.once(self._node.advance)  # what has come before may be all that is needed

    def row_rules(self, every_row: bool, replace: bool) -> dict[str, Any]:
        return {"missing": Missing.REFUSE if every_row else Missing.SKIP}

    def accepted(self, source: Input, tick: int, stamp: int, lost: int) -> None:
        self._node.advance()

    def came_again(self, source: Input, receipt: Receipt) -> None:
        self._node.counts[f"{source.topic}: duplicate"] += 1
        oldest = source.rows.repetition_due(time.monotonic())
        if oldest is not None:  # they ask for those that followed from them
            self._node.repeat(source, oldest)

    def waits(self, now: float) -> list[Wait]:
        return [] if self._node.finished.done() else waits(self._node.received, now)
