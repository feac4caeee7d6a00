# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of the commands: a page for each, written from its parser."""

from __future__ import annotations

import argparse
import re

HEAD = """# Commands

`hyst COMMAND --help` prints the same.

| command | |
|---|---|
"""


def command_pages(top: argparse.ArgumentParser) -> dict[str, str]:
    """Every subcommand's page by its name, and their list as `index`."""
    [subcommands] = (action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    commands = dict(sorted(subcommands.choices.items()))
    index = HEAD + "".join(f"| [`{top.prog} {name}`]({name}.md) | {_escaped(_title(sub))} |\n" for name, sub in commands.items())
    return {"index": index} | {name: _section(f"{top.prog} {name}", sub, "#") for name, sub in commands.items()}


def _title(parser: argparse.ArgumentParser) -> str:
    return (parser.description or "").strip().split("\n\n")[0].replace("\n", " ")


def _section(name: str, parser: argparse.ArgumentParser, level: str) -> str:
    """A command; one that has subcommands of its own shows each of them."""
    description, _, examples = (parser.description or "").strip().partition("\n\nexample")
    parts = [f"{level} {name}\n\n", _escaped(description)]
    if examples:
        parts.append("\n\n```\n" + re.sub(r"(?m)^  ", "", examples.partition("\n")[2]) + "\n```")
    rows = [_row(action) for action in parser._actions if _is_shown(action)]
    if rows:
        parts.append("\n\n| argument | default | |\n|---|---|---|\n" + "\n".join(rows))
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    nested = "".join(
        "\n" + _section(f"{name} {word}", sub, f"{level}#") for action in inner for word, sub in action.choices.items()
    )
    return "".join(parts) + "\n" + nested


def _is_shown(action: argparse.Action) -> bool:
    hidden = isinstance(action, (argparse._HelpAction, argparse._SubParsersAction)) or action.help == argparse.SUPPRESS
    return not hidden and action.dest not in ("json", "quiet")


def _row(action: argparse.Action) -> str:
    value = action.metavar or ("" if action.nargs == 0 else action.dest.upper())
    shown = " ".join(value) if isinstance(value, tuple) else value
    several = "…" if action.nargs in ("+", "*") else ""
    names = ", ".join(f"`{name}`" for name in action.option_strings) or f"`{shown}{several}`"
    if action.option_strings and shown:
        names += f" `{shown}{several}`"
    default = "" if action.default in (None, False, argparse.SUPPRESS) or action.default == [] else f"`{action.default}`"
    meaning = (action.help or "").replace("%%", "%")
    choices = f" (one of {', '.join(map(str, action.choices))})" if action.choices else ""
    return f"| {names} | {default} | {_escaped(meaning + choices)} |"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")
