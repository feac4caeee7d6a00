"""Reference of all nodes' parameters as Markdown, made from their declarations."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable
from typing import Any

from hyst_control.nodes.common_parameters import COMMON
from hyst_control.nodes.parameters import Setting
from hyst_control.processes.node_list import NODES, NodeEntry

HEAD = """# Parameters of the nodes

Written by `python docs/make_reference.py` from the nodes' declarations.

A parameter is given with `-p name:=value` behind `--ros-args`, or in a parameter file (`config/nodes`); a value of the wrong type or out
of its range is refused with one line. A parameter marked *live* may be changed while the node runs (`ros2 param set`); others are
read once at the start. The feedforward and the reference generator take further parameters of their kind of compensator and signal:
`hyst excite --help` lists the signals.

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


def parameter_reference() -> str:
    """Every node with its parameters: type, unit, range, default and meaning.

    Returns
    -------
    str
        Text of the page `docs/parameters.md`.
    """
    parts = [HEAD, "\n## all nodes of the loop\n\nParameters that every node below has.\n\n", _table(COMMON)]
    for name, entry in NODES.items():
        node = _with_settings(entry)
        if node is not None:
            title = (inspect.getdoc(node) or "").split("\n\n")[0].replace("\n", " ")
            parts.append(f"\n## {name}\n\n{title}\n\n{_table(node.SETTINGS)}")
    return "".join(parts)


def _with_settings(entry: NodeEntry) -> Any:
    """Class of a node that declares settings; None where it has none of its own."""
    module = importlib.import_module(entry.module)
    own = (each for each in vars(module).values() if inspect.isclass(each) and each.__module__ == entry.module)
    return next((each for each in own if hasattr(each, "SETTINGS")), None)


def _table(settings: Iterable[Setting]) -> str:
    head = "| parameter | type | unit | range | default | live | |\n|---|---|---|---|---|---|---|\n"
    return head + "".join(_row(setting) for setting in settings)


def _row(setting: Setting) -> str:
    several = isinstance(setting.default, tuple)
    value = setting.default[0] if several else setting.default
    kind = {bool: "truth value", int: "integer", float: "number", str: "text"}[type(value)]
    default = ", ".join(_shown(item) for item in setting.default) if several else _shown(setting.default)
    cells = (
        f"`{setting.name}`",
        f"list of {kind}s" if several else kind,
        setting.unit,
        allowed(setting),
        default,
        "live" if setting.live else "",
        setting.text,
    )
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def allowed(setting: Setting) -> str:
    """Range or choices of a setting in words; "" where every value of its type is allowed.

    Parameters
    ----------
    setting : Setting
        The setting.

    Returns
    -------
    str
        Such as "0 … 99" or "`lockstep`, `timer`".
    """
    if setting.choices:
        return ", ".join(f"`{choice}`" for choice in setting.choices)
    if setting.lower is None and setting.upper is None:
        return ""
    lower, upper = ("any" if limit is None else f"{limit:g}" for limit in (setting.lower, setting.upper))
    return f"{lower} … {upper}"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else f"`{value}`" if isinstance(value, str) and value else str(value)
