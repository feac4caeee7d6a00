# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reading YAML: the one loader for every text that comes from outside, with limits that no honest file meets.

YAML lets a few hundred bytes stand for gigabytes (aliases of aliases), and a loader that follows the nesting with its own stack ends the
process where the text is nested deeply enough. So the events of a text are counted before anything is built from them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import first_line

MAX_BYTES = 4 * 2**20  # Length of a text
MAX_DEPTH = 64  # Lists and mappings within each other
MAX_NODES = 200_000  # Values, every alias counted as all that it stands for
MAX_KEYS = 10_000  # Keys of one mapping
MAX_CHARACTERS = 2**16  # Length of one value: a number of a million digits takes minutes to read

EXPONENT = ("tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789"))
"""Texts that are numbers everywhere but in YAML 1.1, as the rule that loader and dumper take."""


def read_yaml(path: str | Path, remedy: str = "give the path of a YAML file") -> Any:
    """Content of a YAML file."""
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}: {remedy}") from None
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file: {remedy}") from None
    return parse_yaml(text, path)


def parse_yaml(text: str, where: str | Path) -> Any:
    """Content of a YAML text; `where` names it in errors. Raises `InputError`."""
    try:
        _check(text)
        return yaml.load(text, Loader=_Loader)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except yaml.MarkedYAMLError as error:
        line = f" line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{where}:{line} is not valid YAML: {error.problem or 'unreadable'}") from None
    except yaml.YAMLError:
        raise InputError(f"{where}: is not valid YAML: unreadable") from None
    except Exception as error:  # a tag such as !!timestamp before what is none raises whatever its parser meets
        raise InputError(f"{where}: is not valid YAML: a value does not fit its tag ({first_line(error)})") from None


def _check(text: str) -> None:
    """Count what a text holds without building it."""
    if len(text) > MAX_BYTES:
        raise InputError(f"is longer than {MAX_BYTES >> 20} MiB: split it, or keep large arrays in .npy files")
    nodes = 0
    anchors: dict[str, int] = {}  # Nodes of everything anchored so far
    open_nodes: list[tuple[str | None, int]] = []
    """Anchor and count at the beginning of the lists and mappings that are not closed yet."""
    room = [1]  # Number of values that each of them may still take
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.NodeEvent):
            room[-1] -= 1
            if room[-1] < 0:
                raise InputError(f"holds a mapping of more than {MAX_KEYS} keys: split it")
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_nodes):
                raise InputError(f"the alias *{event.anchor} stands within itself: write the values out")
            nodes += anchors.get(str(event.anchor), 1)
        elif isinstance(event, yaml.ScalarEvent):
            nodes += 1
            if len(event.value) > MAX_CHARACTERS:
                if not open_nodes:
                    raise InputError(
                        f"is no YAML of keys and values, but one text of {len(event.value)} characters: give another file"
                    )
                raise InputError(f"holds a value of {len(event.value)} characters: at most {MAX_CHARACTERS} are read")
            if event.anchor is not None:
                anchors[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            nodes += 1
            open_nodes.append((event.anchor, nodes))
            room.append(2 * MAX_KEYS if isinstance(event, yaml.MappingStartEvent) else MAX_NODES)
            if len(open_nodes) > MAX_DEPTH:
                raise InputError(f"is nested more than {MAX_DEPTH} deep: flatten it")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, begin = open_nodes.pop()
            room.pop()
            if anchor is not None:
                anchors[anchor] = nodes - begin + 1
        if nodes > MAX_NODES:
            raise InputError(f"holds more than {MAX_NODES} values, its aliases counted: split it")


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Safe loading in which 1e-4 is a number, as it is everywhere but in YAML 1.1, and a key may stand once only."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            try:
                if key in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"the key {key!r} stands twice", key_node.start_mark)
                seen.add(key)
            except TypeError:
                raise yaml.constructor.ConstructorError(None, None, "a list or mapping cannot be a key", node.start_mark) from None
        return dict(super().construct_mapping(node, deep))


_Loader.add_implicit_resolver(*EXPONENT)
