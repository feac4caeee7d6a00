# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`make mutate`: mutation tests of the checks at every entry.

Does a test notice when a check is missing?
Every `except`, and every check, of the modules where foreign numbers and files enter is taken out in turn, and the tests of that module
are run. A mutant that they pass survives, and is printed.

All of it runs in one process, which has collected the tests once. In a fork of it they run without any mutant, and it is noted which of
them reach which check. Each mutant is then put into a fork of its own, in place of the functions that it changes, with the tests that
reach it, the shortest first, until one fails. Programs that a test starts see the mutant too: they import a copy of the sources.

Arguments: parts of module names, to mutate only those; `--write` puts their rows into the table of
docs/safety.md.
"""

from __future__ import annotations

import ast
import gc
import importlib
import os
import pickle
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "safety.md"
BEGIN, END = "<!-- made by `make mutate ARGS=--write` -->\n", "<!-- end -->\n"

LONGEST = 60.0
"""s, at least, that the tests of one mutant may take; one that hangs is noticed."""

REFUSALS = "test/records/test_refusals.py"
BAGS = (
    REFUSALS,
    "test/records/test_hostile_bags.py",
    "test/records/test_bag_writer.py",
    "test/records/test_record.py",
    "test/records/test_bag_fields.py",
)
TABLES = (
    REFUSALS,
    "test/records/test_hostile_tables.py",
    "test/records/test_importing.py",
    "test/records/test_instrument_texts.py",
    "test/records/test_containers.py",
    "test/records/test_sample_grid.py",
)
ENTRY = ("test/nodes/test_entry.py",)
VALIDITY = ("test/records/test_record_validity.py", "test/diagnose/test_invalid_records.py")
LOOP = (
    "test/control/test_sensor_watch.py",
    "test/control/test_safe_loop.py",
    "test/control/test_live_changes.py",
    "test/control/test_pi.py",
)


@dataclass(frozen=True)
class Module:
    """Tests that answer for a module, and what counts as a check there.

    Attributes
    ----------
    tests : tuple of str
        Files of tests.
    checks : str
        "raise": an `if` that ends in `raise`; "drop": one that drops a message or returns early too; "every": every `if`.
    """

    tests: tuple[str, ...]
    checks: str = "raise"


MODULES: dict[str, Module] = {
    "hyst_control/records/stream/foreign_rows.py": Module(("test/records/test_foreign_rows.py", *ENTRY), "drop"),
    "hyst_control/nodes/signal_node/message_io.py": Module(("test/nodes/test_message_io.py",), "drop"),
    "hyst_control/nodes/signal_node/signal_ports.py": Module(ENTRY, "drop"),
    "hyst_control/nodes/signal_node/watched_signal.py": Module(ENTRY, "drop"),
    "hyst_control/nodes/loop/recorded_topic.py": Module(ENTRY, "drop"),
    "hyst_control/nodes/loop/rival_watch.py": Module(ENTRY, "drop"),
    "hyst_control/nodes/loop/takeover.py": Module(ENTRY, "drop"),
    "hyst_control/records/stream/signal_rows.py": Module(
        ("test/records/test_signal_rows.py", "test/records/test_foreign_rows.py"), "drop"
    ),
    "hyst_control/records/stream/signal_message.py": Module(("test/records/test_signal_message.py",)),
    "hyst_control/nodes/identification.py": Module(("test/nodes/test_identification.py",)),
    "hyst_control/control/feedback/safe_loop.py": Module(LOOP, "every"),
    "hyst_control/control/feedback/sensor_watch.py": Module(LOOP, "every"),
    "hyst_control/control/feedback/command_watchdog.py": Module(
        ("test/control/test_safe_loop.py", "test/nodes/test_actuator.py"), "every"
    ),
    "hyst_control/nodes/loop/actuator.py": Module(("test/nodes/test_actuator.py",), "every"),
    "hyst_control/hardware/driver_thread.py": Module(("test/nodes/test_driver_thread.py",), "every"),
    "hyst_control/hardware/stage_node.py": Module(("test/nodes/test_stage_faults.py", "test/nodes/test_hardware.py"), "every"),
    "hyst_control/base/yaml_files.py": Module(("test/test_yaml_files.py",)),
    "hyst_control/base/files.py": Module(("test/test_files.py",)),
    "hyst_control/base/foreign_readers.py": Module(TABLES),
    "hyst_control/records/tables/array_files.py": Module(TABLES),
    "hyst_control/records/tables/importing.py": Module(TABLES),
    "hyst_control/records/tables/regular_signals.py": Module(TABLES),
    "hyst_control/records/tables/columns.py": Module(TABLES),
    "hyst_control/records/tables/selection.py": Module(TABLES),
    "hyst_control/records/tables/text.py": Module(TABLES),
    "hyst_control/records/bags/bag_reader.py": Module(BAGS),
    "hyst_control/records/bags/bag_files.py": Module(BAGS),
    "hyst_control/records/bags/bag_fields.py": Module(BAGS),
    "hyst_control/records/bags/mcap_stream.py": Module(BAGS),
    "hyst_control/records/bags/sqlite_bag.py": Module(BAGS),
    "hyst_control/records/bags/decompression.py": Module(BAGS),
    **{
        f"hyst_control/records/validity/{name}.py": Module(VALIDITY, "every")
        for name in ("causality", "time_shift", "clipping", "incoherence", "sensor", "two_records", "beside_model")
    },
    "hyst_control/diagnose/report/invalid_records.py": Module(VALIDITY, "every"),
}
"""Modules in which foreign numbers and files enter, or are judged."""


@dataclass(frozen=True)
class Mutant:
    """One expression that is taken out: its line and column, what is in its place, the first line behind it, and what it was."""

    line: int
    column: int
    kind: str
    body: int
    what: str


def mutants(source: str, checks: str) -> Iterator[Mutant]:
    """Every `except` that catches nothing, and every check that never applies."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ExceptHandler) and node.type is not None:
            yield _mutant(node.type, "except", node.body[0].lineno)
        elif (
            isinstance(node, ast.If)
            and "__main__" not in ast.unparse(node.test)
            and (checks == "every" or _refuses(node.body, checks))
        ):
            yield _mutant(node.test, "if", node.body[0].lineno)
        elif isinstance(node, ast.IfExp) and checks == "drop" and "Refusal" in ast.unparse(node.body):
            yield _mutant(node.test, "if", node.lineno)


def _mutant(node: ast.expr, kind: str, body: int) -> Mutant:
    return Mutant(node.lineno, node.col_offset, kind, body, f"line {node.lineno}: {kind} {ast.unparse(node)}")


def _refuses(body: list[ast.stmt], checks: str) -> bool:
    if isinstance(body[-1], ast.Raise):
        return True
    text, last = "".join(ast.unparse(each) for each in body), ast.unparse(body[-1])
    return checks == "drop" and (
        "drop(" in text or last in ("return", "continue") or any(word in last for word in ("Refusal", "refused_values", "Receipt."))
    )


class _TakeOut(ast.NodeTransformer):
    """`if test` becomes `if False and test`, `except Kind` becomes `except ()`."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant

    def _is(self, node: ast.expr | None) -> bool:
        return node is not None and (node.lineno, node.col_offset) == (self.mutant.line, self.mutant.column)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if self.mutant.kind == "except" and self._is(node.type):
            node.type = ast.Tuple([], ast.Load())
        return self.generic_visit(node)

    def _without(self, node: Any) -> ast.AST:
        if self.mutant.kind == "if" and self._is(node.test):
            node.test = ast.BoolOp(ast.And(), [ast.Constant(False), node.test])
        return self.generic_visit(node)

    visit_If = visit_IfExp = _without


def mutated(source: str, mutant: Mutant) -> ast.Module:
    """The source with the mutant in it; its lines keep their numbers."""
    return ast.fix_missing_locations(_TakeOut(mutant).visit(ast.parse(source)))


def put_in(path: Path, name: str, tree: ast.Module) -> None:
    """Replace the functions of a module in this process, wherever they are used.

    Parameters
    ----------
    path, name : Path, str
        File of the module, and its name.
    tree : ast.Module
        The new text.
    """
    importlib.import_module(name)
    gc.unfreeze()  # what is frozen is not among the objects that the collector lists
    new = dict(_codes(compile(tree, str(path), "exec", dont_inherit=True)))
    for function in [each for each in gc.get_objects() if isinstance(each, FunctionType)]:
        code = function.__code__
        if code.co_filename == str(path):
            found = new[_key(code)]
            if len(found.co_freevars) == len(code.co_freevars):
                function.__code__ = found


def _codes(code: CodeType) -> Iterator[tuple[tuple[object, ...], CodeType]]:
    yield _key(code), code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes(each)


def _key(code: CodeType) -> tuple[object, ...]:
    return code.co_name, code.co_firstlineno, code.co_varnames[: code.co_argcount]


@dataclass
class Runs:
    """Course of the tests without a mutant: seconds of each, the lines that each reaches, and those that failed."""

    seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, set[tuple[str, int]]] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)


class Mutation:
    """Plugin of pytest that runs the tests of mutants in place of the tests."""

    def __init__(self, folder: Path, modules: dict[str, Module]) -> None:
        self.folder, self.modules = folder, modules
        self.failed = False
        self.runs = Runs()
        self.results: dict[str, tuple[int, list[str]]] = {}
        """Of each module: number of mutants, and those that survive."""

    def pytest_sessionstart(self) -> None:
        """Have Hypothesis end at the first failure: nobody reads the smallest one."""
        from hypothesis import Phase, settings

        settings.register_profile("mutants", phases=(Phase.explicit, Phase.generate))
        settings.load_profile("mutants")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure."""
        self.failed = self.failed or report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the mutants."""
        session.config.pluginmanager.unregister(name="terminalreporter")
        for path, module in self.modules.items():
            self._module(path, module, session.items)
        return True

    def _module(self, path: str, module: Module, items: Sequence[pytest.Item]) -> None:
        begin, place, runs = time.monotonic(), self.folder / path, self.runs
        source = place.read_text(encoding="utf-8")
        found = sorted(mutants(source, module.checks), key=lambda mutant: (mutant.line, mutant.column))
        own = [item for item in items if item.nodeid.split("::")[0] in module.tests]
        self._without_mutant([item for item in own if item.nodeid not in runs.seconds])
        own = [item for item in own if item.nodeid not in runs.failed]
        survivors = []
        for mutant in found:
            reached = [item for item in own if (path, mutant.body) in runs.lines[item.nodeid]]
            chosen = sorted(reached or own, key=lambda item: runs.seconds[item.nodeid])
            tree = mutated(source, mutant)
            place.write_text(ast.unparse(tree), encoding="utf-8")
            longest = LONGEST + 5.0 * sum(runs.seconds[item.nodeid] for item in chosen)
            if self._passes(chosen, lambda tree=tree: put_in(place, path[:-3].replace("/", "."), tree), longest):
                survivors.append(mutant.what + ("" if reached else " (no test reaches it)"))
        place.write_text(source, encoding="utf-8")
        self.results[path] = len(found), survivors
        say(f"{path}: {len(found) - len(survivors)} of {len(found)} noticed, {time.monotonic() - begin:.0f} s")
        for each in survivors:
            say(f"  survives: {each}")

    def _without_mutant(self, items: Sequence[pytest.Item]) -> None:
        """Run tests in a fork, with every line of the modules traced, and note what they do."""
        file = self.folder / "runs.pickle"
        if items:
            forked(lambda: file.write_bytes(pickle.dumps(self._traced(items))) * 0, 3600.0)
            found = pickle.loads(file.read_bytes())
            self.runs.seconds |= found.seconds
            self.runs.lines |= found.lines
            self.runs.failed += found.failed
            for each in found.failed:
                say(f"fails without any mutant, and is left out: {each}")

    def _traced(self, items: Sequence[pytest.Item]) -> Runs:
        runs, places = Runs(), {str(self.folder / path): path for path in self.modules}
        lines: set[tuple[str, int]] = set()

        def trace(frame: FrameType, event: str, _: object) -> Any:
            path = places.get(frame.f_code.co_filename)
            if path is None:
                return None
            if event == "line":
                lines.add((path, frame.f_lineno))
            return trace

        threading.settrace(trace)
        for item, following in zip(items, [*items[1:], None]):
            begin, self.failed, lines = time.monotonic(), False, set()
            sys.settrace(trace)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            sys.settrace(None)
            runs.seconds[item.nodeid], runs.lines[item.nodeid] = time.monotonic() - begin, lines
            if self.failed:
                runs.failed.append(item.nodeid)
        return runs

    def _passes(self, items: Sequence[pytest.Item], change: Callable[[], None], longest: float) -> bool:
        def run() -> int:
            change()
            for item, following in zip(items, [*items[1:], None]):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if self.failed:
                    item.session._setupstate.teardown_exact(None)
                    return 1
            return 0

        return forked(run, longest) == 0


def forked(run: Callable[[], int], longest: float) -> int:
    """Exit status of what runs in a fork of this process, without its output; it is killed after `longest` s (status -9)."""
    child = os.fork()
    if not child:
        status = 3
        try:
            os.setpgid(0, 0)
            nothing = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(nothing, stream)
            status = run()
        finally:
            os._exit(status)
    end = time.monotonic() + longest
    status = None
    while status is None and time.monotonic() < end:
        done, found = os.waitpid(child, os.WNOHANG)
        status = os.waitstatus_to_exitcode(found) if done else None
        time.sleep(0.005)
    try:
        os.killpg(child, signal.SIGKILL)  # what it has started and left
    except ProcessLookupError:
        pass
    if status is None:
        os.waitpid(child, 0)
        return -signal.SIGKILL
    return status


def say(line: str) -> None:
    """Write a line where pytest does not catch it."""
    os.write(OUT, line.encode() + b"\n")


OUT = os.dup(1)


def copy_of_sources(folder: Path) -> None:
    """Copy what the tests need into a folder."""
    for part in ("hyst_control", "hyst_plant_sim", "evaluation", "config", "test", "pyproject.toml"):
        source = ROOT / part
        if source.is_dir():
            shutil.copytree(source, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / part)


def table(counts: dict[str, tuple[int, int]]) -> str:
    """Numbers of mutants and of those noticed, by module, as a table in Markdown."""
    rows = ["| module | checks taken out | noticed |", "|---|---|---|"]
    rows += [f"| `{path}` | {total} | {noticed} |" for path, (total, noticed) in counts.items()]
    total, noticed = (sum(each) for each in zip(*counts.values()))
    rows.append(f"| all | {total} | {noticed} ({100 * noticed / max(total, 1):.1f} %) |")
    return "\n".join(rows) + "\n"


def written(text: str, counts: dict[str, tuple[int, int]]) -> str:
    """Text of the page with the rows of these modules in its table; those of others stay."""
    before, rest = text.split(BEGIN)
    old, after = rest.split(END)
    known = {path: (int(total), int(noticed)) for path, total, noticed in re.findall(r"\| `(\S+)` \| (\d+) \| (\d+) \|", old)}
    merged = {path: (known | counts)[path] for path in MODULES if path in known or path in counts}
    return before + BEGIN + (table(merged) if merged else "") + END + after


def main() -> int:
    """Run the mutants; exit status 1 when the tests fail without any."""
    write, parts = "--write" in sys.argv, [each for each in sys.argv[1:] if each != "--write"]
    chosen = {path: module for path, module in MODULES.items() if not parts or any(part in path for part in parts)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        copy_of_sources(folder)
        os.chdir(folder)
        os.environ["PYTHONPATH"] = str(folder)
        sys.dont_write_bytecode = True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        sys.path[:] = [str(folder), *(each for each in sys.path if each != str(Path(__file__).parent))]
        plugin = Mutation(folder, chosen)
        tests = sorted({test for module in chosen.values() for test in module.tests})
        options = ["-q", "-p", "no:cacheprovider", "-p", "no:faulthandler", "-p", "no:xdist", f"--basetemp={folder / 'made'}"]
        status = pytest.main([*options, *tests], plugins=[plugin])
        os.chdir(ROOT)
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        return 1
    counts = {path: (total, total - len(survivors)) for path, (total, survivors) in plugin.results.items()}
    if write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), counts), encoding="utf-8")
    total, noticed = (sum(each) for each in zip(*counts.values()))
    say(f"{noticed} of {total} mutants noticed, {100 * noticed / max(total, 1):.1f} %")
    return 1 if plugin.runs.failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
