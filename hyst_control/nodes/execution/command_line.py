# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Command line of an executable of nodes: `--help`, and arguments that nobody would look at."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.base.quantity import shown
from hyst_control.nodes.signal_node.parameters import Setting, nearest

WIDTH = 100
"""Columns of the help."""
USAGE = """usage: {name} [--help] --ros-args [--params-file FILE.yaml] [-p PARAMETER:=VALUE] [-r __ns:=NAMESPACE] ..."""


def wants_help(arguments: Sequence[str]) -> bool:
    """True when the arguments of a command line, the program first, ask for help before those of ROS begin."""
    own = list(arguments[1:])
    own = own[: own.index("--ros-args")] if "--ros-args" in own else own
    return "--help" in own or "-h" in own


def help_text(program: str, node_classes: Sequence[Any]) -> str:
    """Help of an executable: its nodes, and their parameters with unit, range and default."""
    parts, common = [USAGE.format(name=Path(program).name)], dict[str, Setting]()
    for node_class in node_classes:
        title = (inspect.getdoc(node_class) or "").split("\n\n")[0].replace("\n", " ")
        own = {setting.name: setting for setting in node_class.SETTINGS}
        common |= {setting.name: setting for setting in node_class.COMMON_SETTINGS if setting.name not in own}
        name = inspect.signature(node_class).parameters["name"].default or node_class.NAME
        parts += [f"\n{name}: {title}", "parameters:", _listed(own.values())]
        if node_class.FURTHER:
            parts.append(node_class.FURTHER)
    if common:
        parts += ["\nparameters that all nodes of the loop have:", _listed(common.values())]
    return "\n".join(parts)


def check(arguments: Sequence[str]) -> None:
    """Refuse a parameter file that is missing, before ROS says less about it."""
    for option, value in zip(arguments, arguments[1:]):
        if option == "--params-file" and not Path(value).is_file():
            raise InputError(f"--params-file {value}: there is no such file")


def check_rest(program: str, rest: Sequence[str]) -> None:
    """Refuse arguments that are not ROS's: nobody would look at them."""
    if rest:
        remedy = ": put --ros-args before it" if rest[0].startswith("-") else nearest(rest[0], ("--help", "--ros-args"))
        raise InputError(f"{Path(program).name}: {rest[0]}: there is no such argument{remedy}")


def _listed(settings: Iterable[Setting]) -> str:
    lines = []
    for setting in settings:
        facts = [setting.unit, setting.values, f"default {shown(setting.default) or 'none'}", liveness(setting).replace("`", "")]
        lines.append(f"  {setting.name}  [{'; '.join(fact for fact in facts if fact)}]")
        lines += textwrap.wrap(setting.meaning, WIDTH, initial_indent="      ", subsequent_indent="      ")
    return "\n".join(lines)


def liveness(setting: Setting) -> str:
    """Words on a setting that may be changed live, and on the parameter that bounds it then."""
    if not (setting.live and setting.wider):
        return "live" if setting.live else ""
    return f"live, {'at most' if setting.wider == 'higher' else 'at least'} `{setting.bound_name}`"
