# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Command line of an executable of nodes: `--help`, and arguments that nobody would look at."""

from __future__ import annotations

import inspect
import textwrap
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.validate_namespace import validate_namespace

from hyst_control.base.errors import InputError
from hyst_control.base.quantity import shown
from hyst_control.base.yaml_files import read_yaml
from hyst_control.nodes.signal_node.parameters import Setting, matches, nearest
from hyst_control.processes.node_list import NODES

WIDTH = 100  # Columns of the help
MISSPELT = 0.85  # Likeness from which the name of a section is that of a node, misspelt
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
        parts += [f"\n{name_of(node_class)}: {title}", "parameters:", _listed(own.values())]
        if node_class.FURTHER:
            parts.append(node_class.FURTHER)
    if common:
        parts += ["\nparameters that all nodes of the loop have:", _listed(common.values())]
    return "\n".join(parts)


def name_of(node_class: Any) -> str:
    """Name of a node without a remap."""
    own = inspect.signature(node_class).parameters.get("name")
    return str((own and own.default) or getattr(node_class, "NAME", ""))


def in_namespace(namespace: str) -> list[str]:
    """ROS arguments that put nodes into a namespace, "" for none. Raises `InputError` where ROS does not allow its name."""
    name = f"/{namespace.strip('/')}"
    try:
        validate_namespace(name)
    except NameValidationException as error:
        raise InputError(f"--namespace: {name_refusal(error)}: choose another name") from None
    return ["-r", f"__ns:={name}"] if name != "/" else []


def name_refusal(error: NameValidationException) -> str:
    """The message of ROS on a name that it does not allow, in one line."""
    return " ".join(str(error).split()).rstrip(" ^")


def check(arguments: Sequence[str], node_classes: Iterable[Any] = ()) -> list[str]:
    """Refuse a parameter file that is missing or has another form, before ROS says less about it, or names a node of this process wrongly.

    Warnings of misspelt sections of others. Any other name is a node's of the user.
    """
    own = [value.rpartition(":=")[2] for value in arguments if value.startswith("__node:=")] or [*map(name_of, node_classes)]
    unknown = []
    for option, value in zip(arguments, arguments[1:]):
        if option == "--params-file":
            if not Path(value).is_file():
                raise InputError(f"--params-file {value}: there is no such file")
            for section, content in _sections(value):
                if not isinstance(content, dict) or "ros__parameters" not in content:
                    raise InputError(f"--params-file {value}: {section}: has no ros__parameters: put the parameters below it")
                if section.rpartition("/")[2] not in (*NODES, *own):
                    unknown.append((value, section))
    warnings, given = [], given_by_name(arguments)
    left = [name for name in (*own, *NODES) if name not in given]
    for value, section in unknown:
        if meant := matches(section.rpartition("/")[2], left, MISSPELT):
            told = f"--params-file {value}: {section}: no node has this name: did you mean {meant[0]}?"
            if meant[0] in own:  # limits of a loop are in such a section: it must not run without them
                raise InputError(told)
            warnings.append(told)
    return warnings


def given_by_name(arguments: Sequence[str]) -> dict[str, set[str]]:
    """Parameters that parameter files and `-p NODE:PARAMETER:=VALUE` give to a node by its name instead of to all nodes."""
    given: dict[str, set[str]] = defaultdict(set)
    for option, value in zip(arguments, arguments[1:]):
        if option == "--params-file":
            for section, content in _sections(value):
                given[section.rpartition("/")[2]].update(content["ros__parameters"] or ())
        elif option in ("-p", "--param"):
            node, _, parameter = value.partition(":=")[0].rpartition(":")
            given[node].add(parameter)
    return given


def _sections(path: str) -> Iterator[tuple[str, Any]]:
    """Nodes of a parameter file, by their whole names, and what the file has of each."""
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"--params-file {path}: must be nodes with their ros__parameters")
    for name, below in content.items():
        inner = below if isinstance(below, dict) and "ros__parameters" not in below else {}
        spaces = {key: value for key, value in inner.items() if isinstance(value, dict) and "ros__parameters" in value}
        yield from ((f"{name}/{key}", value) for key, value in spaces.items())
        if not spaces:
            yield str(name), below


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
