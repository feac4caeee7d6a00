"""Reference of a command line as Markdown, made from its parser."""

from __future__ import annotations

import argparse
import re

HEAD = """# Commands

Written by `python docs/make_reference.py` from the commands' own descriptions: what `hyst COMMAND --help` prints.
"""


def command_reference(top: argparse.ArgumentParser) -> str:
    """Every subcommand with its description, its arguments and their meaning."""
    subcommands = next(action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    return HEAD + "".join(_section(f"{top.prog} {name}", sub) for name, sub in sorted(subcommands.choices.items()))


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    """A command; one that has subcommands of its own shows each of them."""
    description, _, examples = (parser.description or "").strip().partition("\n\nexample")
    parts = [f"\n## {name}\n\n", _escaped(description)]
    if examples:
        parts.append("\n\n```\n" + re.sub(r"(?m)^  ", "", examples.partition("\n")[2]) + "\n```")
    rows = [_row(action) for action in parser._actions if _is_shown(action)]
    if rows:
        parts.append("\n\n| argument | default | |\n|---|---|---|\n" + "\n".join(rows))
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    nested = "".join(_section(f"{name} {word}", sub) for action in inner for word, sub in action.choices.items())
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
