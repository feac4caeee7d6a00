"""Write the reference of nodes and commands from their declarations: `python docs/make_reference.py`, from the repository's root."""

from __future__ import annotations

from pathlib import Path

from hyst_control.cli import parser
from hyst_control.nodes.parameter_reference import parameter_reference
from hyst_control.reporting.command_reference import command_reference

if __name__ == "__main__":
    folder = Path(__file__).parent
    (folder / "parameters.md").write_text(parameter_reference(), encoding="utf-8")
    (folder / "commands.md").write_text(command_reference(parser()), encoding="utf-8")
