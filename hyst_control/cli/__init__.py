# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Command line `hyst`: every module of this package is a subcommand, which only parses arguments and calls the library.

Other distributions add theirs by the entry points `hyst_control.commands`, as `evaluation` does in a checkout.

A subcommand module has `NAME`, `HELP`, `add_arguments(parser)` and `run(arguments)`, and where it has such arguments `READS` and `WRITES`:
names of those that are files or folders. `JSON` says what `--json` writes where that is no table. `run` returns a `CommandResult` with,
where it is not 0, an `exit_status`, and a line `refusal` where nothing came out; or an exit status when it has printed everything itself.
A command that writes its JSON long before it ends calls `arguments.publish()` then, which `--json -` needs.
Imports of the library stand within `run`, so that `hyst --help` is quick. `--json` and `--quiet` are
added here for every subcommand.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import FrameType, ModuleType
from typing import Any, NoReturn, cast

from hyst_control.base import plugins, progress
from hyst_control.base.errors import InputError
from hyst_control.base.files import NO_ROOM, check_outputs, check_writable, refusal, write_json
from hyst_control.base.installed import installed_version
from hyst_control.processes.executables import ros_missing

FIRST_STEPS = """\
Excite, record, identify, control and diagnose piezo stages and fast steering mirrors. To begin with:

  hyst doctor                                what this computer offers, and what to do where that is not enough
  hyst demo                                  the whole way with a simulated stage, in about a minute
  hyst import record.csv --output record     a measured record, from a table or array, as a bag
  hyst identify record --output model.yaml   a model of the stage from such a record
  hyst diagnose record --model model.yaml    where model and stage disagree, and which effect is behind it

`hyst --help` lists all commands, `hyst COMMAND --help` explains one."""


class Parser(argparse.ArgumentParser):
    """Parser that says in one line what is wrong, without all options."""

    given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Arguments in a namespace, and no others: those that are not known are refused under the name of the command."""
        self.given = sys.argv[1:] if args is None else args
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """End with the message and exit status 2."""
        words = {word.partition("=")[0] for word in self.given}
        several = [action for action in self._actions if action.nargs not in (None, 0)]
        taking = [name for action in several for name in action.option_strings if name in words]  # it may have taken files, too
        stray = message.startswith("unrecognized") and ": -" not in message and any(not action.option_strings for action in several)
        if stray or (taking and message.startswith(("the following", *(f"argument {name}:" for name in taking)))):
            message += ": put the files before the options"
        self.exit(2, f"{self.prog}: {message}: see {self.prog} --help\n")


def parser() -> Parser:
    """Parser of all subcommands."""
    top = Parser(
        prog="hyst",
        description="Excite, record, identify, control and diagnose piezo stages and fast steering mirrors.",
        epilog="`hyst COMMAND --help` explains a command.",
    )
    top.add_argument("--version", action="version", version=f"hyst_control {installed_version()}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND")
    found = {module.NAME: module for module in (import_module(f"{__name__}.{each.name}") for each in iter_modules(__path__))}
    plugins.load("commands", lambda name, module: found.setdefault(name, cast(ModuleType, module)))
    for _, command in sorted(found.items()):
        sub = commands.add_parser(
            command.NAME, help=command.HELP, description=command.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        command.add_arguments(sub)
        sub.add_argument(
            "--json",
            metavar="OUT",
            help=f"{getattr(command, 'JSON', 'result table')} to write as JSON; -: to the standard output, with all text on the standard "
            "error",
        )
        sub.add_argument("--quiet", action="store_true", help="do not show progress (it is shown on a terminal only)")
        sub.set_defaults(run=command.run, reads=getattr(command, "READS", ()), writes=("json", *getattr(command, "WRITES", ())))
        sub.set_defaults(publish=lambda: None)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    _interrupted_by(signal.SIG_DFL, argv)  # while commands are loaded, which a traceback would tell nothing about
    _open_what_is_closed()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that knows no µ, a file's name that is no text
    top = parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell requests completions
        import argcomplete

        argcomplete.autocomplete(top)
    arguments = top.parse_args(argv)
    if arguments.command is None:
        print(FIRST_STEPS)
        return 0
    if argv is None:
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends all that was started, as Ctrl-C does
        sys.unraisablehook = _interrupt_again
    try:
        _interrupted_by(signal.default_int_handler, argv)
        return run(arguments)
    except InputError as error:
        reason = str(error)
    except ModuleNotFoundError as error:
        if not (reason := ros_missing(error)):
            raise
    except BrokenPipeError:  # `hyst … | head` has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at the end
        return 0
    except OSError as error:
        written = [path for name in arguments.writes if (path := getattr(arguments, name))] if error.errno in NO_ROOM else []
        reason = refusal(error, error.filename or ", ".join(written), "check the path and its permissions")
    except MemoryError as error:
        reason = f"not enough memory{f' ({error})' if str(error) else ''}: free memory, or take shorter records"
    except KeyboardInterrupt:
        print(f"hyst {arguments.command}: interrupted", file=sys.stderr)
        return 130
    finally:
        _interrupted_by(signal.SIG_DFL, argv)  # while the interpreter ends
    print(f"hyst {arguments.command}: {reason}", file=sys.stderr)
    return 2


def _interrupt_again(dropped: sys.UnraisableHookArgs) -> None:
    """Send once more an interrupt that came where Python can raise nothing, as in a destructor or a callback of its import lock."""
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)
        return
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()  # here it would be dropped again


def _interrupted_by(handler: signal.Handlers | Callable[[int, FrameType | None], object], argv: Sequence[str] | None) -> None:
    """Set what Ctrl-C does to the process of a command, unless it was started with interrupts ignored, as by `nohup`."""
    if argv is None and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, handler)


def _open_what_is_closed() -> None:
    """Stand in for streams that were closed by who started this process: else the next file that is opened would take their place."""
    if sys.stdin is None or sys.stdout is None or sys.stderr is None:
        while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
            os.set_inheritable(number, True)
        os.close(number)
        sys.stdin, sys.stdout, sys.stderr = (
            stream or os.fdopen(number, mode)
            for number, (stream, mode) in enumerate(((sys.stdin, "r"), (sys.stdout, "w"), (sys.stderr, "w")))
        )


def run(arguments: argparse.Namespace) -> int:
    """Run a subcommand, print its result, and write it as JSON where requested."""
    seed = getattr(arguments, "seed", None)  # of every command that has one
    if isinstance(seed, int) and seed < 0:
        raise InputError(f"--seed: must be >= 0, got {seed}")
    read = [getattr(arguments, name) for name in arguments.reads]
    check_outputs(
        {f"--{name}": getattr(arguments, name) for name in arguments.writes},
        [path for given in read for path in (given if isinstance(given, list) else [given])],
    )
    if arguments.json != "-":
        if arguments.json is not None:
            check_writable(arguments.json)  # before a run that may take an hour
        return _run_and_print(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path, output = Path(folder) / "result.json", sys.stdout

        def publish() -> None:
            if path.exists():
                output.write(path.read_text(encoding="utf-8"))
                output.flush()
                path.unlink()

        with redirect_stdout(sys.stderr):
            status = _run_and_print(argparse.Namespace(**{**vars(arguments), "json": str(path), "publish": publish}))
        publish()
    return status


def _run_and_print(arguments: argparse.Namespace) -> int:
    with progress.shown(not arguments.quiet):
        result = arguments.run(arguments)
    if result is None or isinstance(result, int):
        return result or 0
    print(result.text())
    if arguments.json is not None:
        write_json(arguments.json, result.document())
    if refusal := getattr(result, "refusal", ""):
        print(f"hyst {arguments.command}: {refusal}", file=sys.stderr)
    return int(getattr(result, "exit_status", 0))
