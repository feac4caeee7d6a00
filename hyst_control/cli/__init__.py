"""`hyst`: one command, a subcommand per job. Every module of this package is a subcommand; each only parses and calls.

A subcommand module has `NAME`, `HELP`, `JSON` (what `--json` writes), `add_arguments(parser)` and `run(arguments)`, and
where it has such arguments `READS` and `WRITES`: names of those that are files or folders. `run` returns its
result, which has `text()` for people and `document()` for programs, or an exit status when it has told everything itself. It imports
what it needs within `run`, so that `hyst --help` is quick. `--json` and `--quiet` are every subcommand's and added here.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from hyst_control import progress
from hyst_control.errors import InputError
from hyst_control.files import check_outputs, check_writable, write_json

ROS = ("rclpy", "std_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces")
"""Packages that nodes need and pip does not bring."""


def parser() -> argparse.ArgumentParser:
    """The parser of all subcommands."""
    top = argparse.ArgumentParser(
        prog="hyst",
        description="Excite, record, identify, control and diagnose piezo stages and fast steering mirrors.",
        epilog="`hyst COMMAND --help` explains a command.",
    )
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in sorted(iter_modules(__path__), key=lambda found: found.name):
        command = import_module(f"{__name__}.{module.name}")
        sub = commands.add_parser(
            command.NAME, help=command.HELP, description=command.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        command.add_arguments(sub)
        sub.add_argument(
            "--json",
            metavar="OUT",
            help=f"{command.JSON} to write as JSON; -: to the standard output, and all else to the standard error",
        )
        sub.add_argument("--quiet", action="store_true", help="no progress, which is shown on a terminal only")
        sub.set_defaults(run=command.run, reads=getattr(command, "READS", ()), writes=("json", *getattr(command, "WRITES", ())))
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run a subcommand. Exit status 0 when it finished, 2 on unusable input (one line says what, where and what to do)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that knows no µ, a file's name that is no text
    top = parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for completions
        import argcomplete

        argcomplete.autocomplete(top)
    arguments = top.parse_args(argv)
    if argv is None:
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # whatever was started is ended, as on Ctrl-C
    try:
        return run(arguments)
    except InputError as error:
        print(f"hyst {arguments.command}: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if error.name not in ROS:
            raise
        print(
            f"hyst {arguments.command}: {error.name} is not installed: source a ROS 2 Jazzy installation, or use make's "
            "environment (make env, then .venv/bin/hyst)",
            file=sys.stderr,
        )
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


def run(arguments: argparse.Namespace) -> int:
    """Run the subcommand, tell its result, write it as JSON where that is asked for; the exit status."""
    read = [getattr(arguments, name) for name in arguments.reads]
    check_outputs(
        {f"--{name}": getattr(arguments, name) for name in arguments.writes},
        [path for given in read for path in (given if isinstance(given, list) else [given])],
    )
    if arguments.json != "-":
        if arguments.json is not None:
            check_writable(arguments.json)  # before what may take an hour
        return _told(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        with redirect_stdout(sys.stderr):
            status = _told(argparse.Namespace(**{**vars(arguments), "json": str(path)}))
        if path.exists():
            sys.stdout.write(path.read_text(encoding="utf-8"))
    return status


def _told(arguments: argparse.Namespace) -> int:
    with progress.shown(not arguments.quiet):
        result = arguments.run(arguments)
    if result is None or isinstance(result, int):
        return result or 0
    print(result.text())
    if arguments.json is not None:
        write_json(arguments.json, result.document())
    return 0
