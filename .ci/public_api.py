# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The public API in one text, `docs/public_api.txt`, written from the code with `--write`; it holds within a major version.

Nothing of plugins is in it, whichever are installed.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "public_api.txt"
SOURCES = ("hyst_control/nodes", "hyst_control/hardware", "hyst_plant_sim")


def python_names() -> Iterator[str]:
    """Names of `import hyst_control as hc`, with signatures and members."""
    import hyst_control as hc

    for name in dir(hc):
        value = getattr(hc, name)
        value = getattr(importlib.import_module(f"hyst_control.{hc._HOME[name]}"), name, value)
        yield f"hc.{name}{'' if name == 'InputError' else inspect.signature(value)}"
        for member, found in sorted(inspect.getmembers(value) if inspect.isclass(value) and name != "InputError" else ()):
            if not member.startswith("_"):
                yield f"hc.{name}.{member}{inspect.signature(found) if callable(found) else ''}"


def commands() -> Iterator[str]:
    """Executables, and the commands of `hyst` with their arguments."""
    from hyst_control.cli import parser
    from hyst_control.processes.node_list import NODES

    yield from (f"executable {name}" for name in ("hyst", *sorted(name for name, node in NODES.items() if node.installed)))
    [subcommands] = [action for action in parser()._actions if isinstance(action, argparse._SubParsersAction)]
    for name, command in sorted(subcommands.choices.items()):
        for action in command._actions:
            if action.dest == "help":
                continue
            shown = " ".join(action.option_strings) or str(action.metavar or action.dest)
            choices = f" {{{', '.join(map(str, action.choices))}}}" if action.choices else ""
            yield f"hyst {name} {shown}{'' if action.nargs is None else f' nargs={action.nargs}'}{choices}"
    from hyst_control.identify.families.estimator import estimators, every_option

    yield from (f"model family {name}" for name in estimators())
    yield from (f"hyst identify option of families {name}" for name in every_option())


def interfaces() -> Iterator[str]:
    """Topics, services and parameters of the nodes."""
    from hyst_control.nodes.signal_node.common_parameters import COMMON
    from hyst_control.processes.node_list import NODES

    for file in sorted(path for folder in SOURCES for path in (ROOT / folder).rglob("*.py")):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.args:
                name = call.args[0]
                if call.func.attr in ("input", "output", "service") and isinstance(name, ast.Constant):
                    yield f"{call.func.attr} {file.stem} {name.value}"
    nodes = {
        name: getattr(importlib.import_module(node.module), node.node_class) for name, node in NODES.items() if node.node_class
    }
    for name, settings in {"every node": COMMON, **{name: node.SETTINGS for name, node in nodes.items()}}.items():
        for each in settings:
            choices = f" {{{', '.join(map(str, each.choices))}}}" if each.choices else ""
            yield f"parameter {name} {each.name} = {each.default!r} {each.unit}{choices}".rstrip()


def formats() -> Iterator[str]:
    """Message layout, stages of model files with their parameters, excitations and effects."""
    from hyst_control.chain import STAGES
    from hyst_control.chain.parameter import declared
    from hyst_control.effects import EFFECTS
    from hyst_control.records.bags.bag_writer import TYPE_HASH
    from hyst_control.records.excitation.excitation import KINDS
    from hyst_control.records.stream.signal_message import MESSAGE_TYPE, label_for

    yield f"message {MESSAGE_TYPE} {TYPE_HASH} {label_for(('x', 'y'), 'um')}"
    yield from (f"stage {name}({', '.join(declared(stage))})" for name, stage in sorted(STAGES.items()))
    yield from (f"excitation {name}" for name in sorted(KINDS))
    yield from (f"effect {name}" for name in sorted(EFFECTS))


def text() -> str:
    """The whole page."""
    parts = (python_names(), commands(), interfaces(), formats())
    return "\n\n".join("\n".join(sorted(set(part))) for part in parts) + "\n"


def main() -> None:
    sys.path.insert(0, str(ROOT))
    from hyst_control.base import plugins

    plugins.load = lambda *_: None
    found = text()
    if "--write" in sys.argv:
        PAGE.write_text(found, encoding="utf-8")
    elif "--show" in sys.argv:
        print(found, end="")
    elif found != PAGE.read_text(encoding="utf-8"):
        sys.exit("the public API is another one: state it in CHANGELOG.md, then run python .ci/public_api.py --write")


if __name__ == "__main__":
    main()
