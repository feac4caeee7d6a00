"""The plant node with the 5,000 axes of a deformable mirror at 1 kHz: processor time of a tick, its messages through the middleware."""

from __future__ import annotations

import json
import subprocess
import sys

from hyst_control.processes.ros_domain import own_domain
from hyst_control.reporting.tables import Table

AXES, RATE, TICKS = 5000, 1000.0, 2000


def run(table: Table, axes: int = AXES, ticks: int = TICKS) -> None:
    """Measure the plant node under the timer, with a sender of commands and a receiver of measurements outside of it."""
    with own_domain() as domain:
        given = [str(value) for value in (axes, ticks, RATE, domain)]
        command = [sys.executable, "-m", "evaluation.benchmarks.many_axes_nodes", *given]
        found = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    node_time, whole, chain = json.loads(found)
    case = f"{axes} axes, model pea_hampi, {RATE / 1e3:g} kHz"
    table.add("many axes", case, "plant's chain", "processor_time", "ms/tick", 1e3 * chain, n=ticks)
    table.add("many axes", case, "plant node", "processor_time", "ms/tick", 1e3 * node_time, n=ticks)
    table.add("many axes", case, "node, sender, receiver, middleware", "processor_time", "ms/tick", 1e3 * whole, n=ticks)
    table.add("many axes", case, "plant node", "load", "% of one core", 100.0 * node_time * RATE, n=ticks)
