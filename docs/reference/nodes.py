# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of the nodes: a page for each with its parameters, written from their declarations."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable
from typing import Any

from docs.reference.tables import table
from hyst_control.base.quantity import shown
from hyst_control.nodes.execution.command_line import liveness
from hyst_control.nodes.signal_node.common_parameters import COMMON
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.nodes.signal_node.signal_settings import signal_settings
from hyst_control.processes.node_list import NODES, NodeEntry
from hyst_control.records.excitation.excitation import KINDS
from hyst_control.records.excitation.parameters import COMMON as OF_EVERY_SIGNAL

HEAD = """# Nodes and their parameters

Set a parameter with `-p name:=value` behind `--ros-args`, or in a parameter file (`config/nodes`). In a file, `/**/pi_feedback` applies
in every namespace. A node refuses an unknown name, a value of the wrong type and a value out of range with one line. `--help` of every
executable lists its parameters. You can change a parameter marked *live* while the node runs (`ros2 param set`); others are read-only then.

Limits, slew limits and timeouts can be narrowed live. They can be widened as far as `max_NAME` (`min_NAME` where a lower value protects
less), which is read at the start; its default is the value at the start. Gains, limits and the parameters of a reference's signal change
without a jump of the command:

- A change of `kp` is bumpless: the integral compensates it.
- Limits move to their new values at `safe_rate`. Without `ki` the command moves at `safe_rate` too.
- A changed signal blends into the new one within `transition`.
- With `backend: c` the gains are compiled in and cannot be changed.

| executable | in | out |
|---|---|---|
| `reference_generator` | `measurement` (the clock) | `reference` |
| `hampi_feedforward`, `mhl_feedforward` | `reference` | `feedforward` |
| `pi_feedback` | `reference`, `feedforward`, `measurement` | `command`, `feedback` |
| `plant` | `command` | `measurement` |
| `simulated_stage`, `pi_stage`, `iio_stage` | `command` | `measurement` of a stage on hardware, in place of `plant` |
| `recorder` | all five | a rosbag2 MCAP bag |
| `identification` | bags | a model file (`~/identify`) |
| `diagnosis` | `command`, `measurement` | `residual`, `gap` with an alarm, a full diagnosis (`~/diagnose`) |
| `live_view` | `reference`, `command`, `measurement` | `live`, `live_turn`: the same with fewer rows, for a page |
| `pipeline` | | the five nodes in one process |

"""


SIGNALS = """# Signals of the reference generator

Parameters of `reference_generator` for its kind of signal, all live; numbers from -1e+12 to 1e+12. A parameter without a default is
required, except those of every kind.

"""


def node_pages() -> dict[str, str]:
    """Every node's page by its name, what all have as `common`, the signals' as `signals`, and their list as `index`."""
    pages = {"common": f"# Parameters of all nodes of the loop\n\nEvery node of the loop has these.\n\n{_table(COMMON)}"}
    for name, entry in NODES.items():
        node = _with_settings(entry)
        if node is not None:
            title = (inspect.getdoc(node) or "").split("\n\n")[0].replace("\n", " ")
            pages[name] = f"# {name}\n\n{title}\n\n{_table(node.SETTINGS)}"
    pages["signals"] = SIGNALS + table(
        "signal | parameter | unit | default | ",
        [
            *(_signal_row(f"`{kind}`", each) for kind in sorted(KINDS) for each in signal_settings(kind)[: -len(OF_EVERY_SIGNAL)]),
            *(_signal_row("every kind", each) for each in signal_settings("rest")[-len(OF_EVERY_SIGNAL) :]),
        ],
    )
    return {"index": HEAD + "".join(f"- [{page.splitlines()[0][2:]}]({name}.md)\n" for name, page in pages.items())} | pages


def _signal_row(kind: str, setting: Setting) -> tuple[str, ...]:
    return kind, setting.name, setting.unit, shown(setting.default), setting.meaning


def _with_settings(entry: NodeEntry) -> Any:
    """Class of a node that declares settings; None where it has none of its own."""
    module = importlib.import_module(entry.module)
    own = (each for each in vars(module).values() if inspect.isclass(each) and each.__module__ == entry.module)
    return next((each for each in own if hasattr(each, "SETTINGS")), None)


def _table(settings: Iterable[Setting]) -> str:
    return table("parameter | type | unit | range | default | live | ", map(_row, settings))


def _row(setting: Setting) -> tuple[str, ...]:
    kind, default = setting.kind.name.removeprefix("a ").removeprefix("an "), shown(setting.default)
    return f"`{setting.name}`", kind, setting.unit, setting.values, default, liveness(setting), setting.meaning
