"""`hyst`: one command, a subcommand per job. Every module of this package is a subcommand; each only parses and calls.

A subcommand module has `NAME`, `HELP`, `add_arguments(parser)` and `run(arguments)`, which returns the exit status or None. It
imports what it needs within `run`, so that `hyst --help` is quick.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from pkgutil import iter_modules

from hyst_control.errors import InputError

ROS = ("rclpy", "std_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces")
"""Packages that nodes need and pip does not bring."""


def parser() -> argparse.ArgumentParser:
    """The parser of all subcommands."""
    top = argparse.ArgumentParser(prog="hyst", description="Excite, record, identify, control and diagnose piezo stages and fast "
                                  "steering mirrors.", epilog="`hyst COMMAND --help` explains a command.")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in sorted(iter_modules(__path__), key=lambda found: found.name):
        command = import_module(f"{__name__}.{module.name}")
        sub = commands.add_parser(command.NAME, help=command.HELP, description=command.__doc__,
                                  formatter_class=argparse.RawDescriptionHelpFormatter)
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run a subcommand. Exit status 0 when it finished, 2 on unusable input (one line says what, where and what to do)."""
    top = parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions
        import argcomplete

        argcomplete.autocomplete(top)
    arguments = top.parse_args(argv)
    if argv is None:
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # whatever was started is ended, as on Ctrl-C
    try:
        return arguments.run(arguments) or 0
    except InputError as error:
        print(f"hyst {arguments.command}: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if error.name not in ROS:
            raise
        print(f"hyst {arguments.command}: {error.name} is not installed: source a ROS 2 Jazzy installation, or use make's "
              "environment (make env, then .venv/bin/hyst)", file=sys.stderr)
        return 2
    except BrokenPipeError:  # `hyst … | head` has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the end's flush finds a place
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"hyst {arguments.command}: {where}{error.strerror or error}: check the path and its permissions", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"hyst {arguments.command}: interrupted", file=sys.stderr)
        return 130
