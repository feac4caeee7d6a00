"""Reference of all nodes' parameters as Markdown, made from their declarations."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable
from typing import Any

from hyst_control.nodes.common_parameters import COMMON
from hyst_control.nodes.parameters import Setting
from hyst_control.nodes.signal_settings import COMMON as OF_EVERY_SIGNAL
from hyst_control.nodes.signal_settings import signal_settings
from hyst_control.processes.node_list import NODES, NodeEntry
from hyst_control.records.excitation import KINDS

HEAD = """# Parameters of the nodes

Written by `python docs/make_reference.py` from the nodes' declarations.

A parameter is given with `-p name:=value` behind `--ros-args`, or in a parameter file (`config/nodes`); in a file, `/**/pi_feedback` holds
in every namespace. A value of the wrong type or out of its range, and a name that the node does not have, are refused with one line.
`--help` of every executable lists its parameters. A parameter marked *live* may be changed while the node runs (`ros2 param set`);
others are read-only then. Limits, slew limits and timeouts may be narrowed live. They may be widened as far as `max_NAME` (`min_NAME` where
a lower value protects less), which is read at the start and is the value at the start unless it is given.

Gains, limits and the parameters of a reference's signal change without a jump of the command. The integral takes up what another `kp`
would add; limits go to their new values at `safe_rate`; without `ki` the command goes to that of the new gains at `safe_rate`; a
signal goes over into the new one within `transition`. With `backend: c` the gains are compiled in and cannot be changed.

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


SIGNALS = """Parameters of `reference_generator` for the kind of signal that it has, all live; numbers from -1e+12 to 1e+12. One without a
default must be given, or is not used if it is one of every kind.

| signal | parameter | unit | default | |
|---|---|---|---|---|
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
    parts += ["\n## Parameters of the signals\n\n", SIGNALS]
    for kind in sorted(KINDS):
        for setting in signal_settings(kind)[: -len(OF_EVERY_SIGNAL)]:
            parts.append(_signal_row(f"`{kind}`", setting))
    parts += [_signal_row("every kind", setting) for setting in signal_settings("rest")[-len(OF_EVERY_SIGNAL) :]]
    return "".join(parts)


def _signal_row(kind: str, setting: Setting) -> str:
    several = isinstance(setting.default, tuple)
    default = ", ".join(_shown(item) for item in setting.default) if several else _shown(setting.default)
    return f"| {kind} | {setting.name} | {setting.unit} | {default} | {setting.text} |\n"


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
        liveness(setting),
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


def liveness(setting: Setting) -> str:
    """Words on a setting that may be changed live, and by which parameter it is bounded then."""
    if not (setting.live and setting.wider):
        return "live" if setting.live else ""
    return f"live, at {'most' if setting.wider == 'higher' else 'least'} `{setting.bound_name}`"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else f"`{value}`" if isinstance(value, str) and value else str(value)
