"""`make mutate`: mutation tests of the checks at every entry.

Does a test notice when a check is missing?
Every `except` and every check (an `if` whose body ends in `raise`, or refuses a message) of the modules where foreign numbers and files
enter is taken out in turn, in a copy of the sources, and the tests of that module are run. A mutant that they pass survives, and is
printed. Arguments: parts of module names, to mutate only those.
"""

from __future__ import annotations

import ast
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import hypothesis  # noqa: F401
import numba  # noqa: F401
import pytest
import rclpy  # noqa: F401
import rosbags.highlevel  # noqa: F401
import scipy.io
import scipy.signal  # noqa: F401

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 300.0
"""s, of the tests of one mutant; one that hangs is noticed."""

REFUSALS = "test/records/test_refusals.py"
BAGS = (REFUSALS, "test/records/test_hostile_bags.py", "test/records/test_bag_writer.py", "test/records/test_record.py")
TABLES = (REFUSALS, "test/records/test_hostile_tables.py", "test/records/test_importing.py")
MODULES: dict[str, tuple[str, ...]] = {
    "hyst_control/records/foreign_rows.py": ("test/records/test_foreign_rows.py",),
    "hyst_control/nodes/signal_ports.py": ("test/nodes/test_entry.py",),
    "hyst_control/nodes/watched_signal.py": ("test/nodes/test_entry.py",),
    "hyst_control/nodes/recorded_topic.py": ("test/nodes/test_entry.py",),
    "hyst_control/nodes/rival_watch.py": ("test/nodes/test_entry.py",),
    "hyst_control/nodes/takeover.py": ("test/nodes/test_entry.py",),
    "hyst_control/records/signal_rows.py": ("test/records/test_signal_rows.py", "test/records/test_foreign_rows.py"),
    "hyst_control/records/signal_message.py": ("test/records/test_signal_message.py",),
    "hyst_control/yaml_files.py": ("test/test_yaml_files.py",),
    "hyst_control/files.py": ("test/test_files.py",),
    "hyst_control/foreign_readers.py": TABLES,
    "hyst_control/records/array_files.py": TABLES,
    "hyst_control/records/importing.py": TABLES,
    "hyst_control/records/bag_reader.py": BAGS,
    "hyst_control/records/mcap_stream.py": BAGS,
    "hyst_control/records/sqlite_bag.py": BAGS,
    "hyst_control/records/decompression.py": BAGS,
}
"""Modules in which foreign numbers and files enter, and the tests that answer for each."""

ENTRIES = ("signal_ports", "watched_signal", "recorded_topic", "rival_watch", "takeover", "foreign_rows", "signal_rows")
"""Modules that refuse by dropping: there an `if` that returns, or drops, is a check too."""


@dataclass(frozen=True)
class Mutant:
    """One text in place of another: begin and end as (line, byte) from 0, the new text, and what it is."""

    begin: tuple[int, int]
    end: tuple[int, int]
    text: str
    what: str


def mutants(source: str, entry: bool) -> Iterator[Mutant]:
    """Every `except` that catches nothing, and every check that never applies."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ExceptHandler) and node.type is not None:
            yield _replaced(node.type, "()", f"except {ast.unparse(node.type)}")
        elif isinstance(node, ast.If) and _refuses(node.body, entry):
            yield _replaced(node.test, "False", f"if {ast.unparse(node.test)}")


def _refuses(body: list[ast.stmt], entry: bool) -> bool:
    if isinstance(body[-1], ast.Raise):
        return True
    text, last = "".join(ast.unparse(each) for each in body), ast.unparse(body[-1])
    return entry and (
        "drop(" in text or last == "return" or any(word in last for word in ("Refusal", "refused_values", "Receipt."))
    )


def _replaced(node: ast.expr, text: str, what: str) -> Mutant:
    assert node.end_lineno is not None and node.end_col_offset is not None
    return Mutant(
        (node.lineno - 1, node.col_offset), (node.end_lineno - 1, node.end_col_offset), text, f"line {node.lineno}: {what}"
    )


def mutated(source: str, mutant: Mutant) -> str:
    """The source with the mutant in it."""
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    (first, begin), (last, end) = mutant.begin, mutant.end
    lines[first : last + 1] = [lines[first][:begin] + mutant.text.encode() + lines[last][end:]]
    return b"".join(lines).decode()


def passes(folder: Path, tests: tuple[str, ...]) -> bool:
    """Whether the tests of a copy pass. They run in a fork of this process, which has the libraries and nothing of the package."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        os.chdir(folder)
        os.environ["PYTHONPATH"] = str(folder)
        sys.dont_write_bytecode = True
        sys.path[:] = [str(folder), *(each for each in sys.path if each != str(Path(__file__).parent))]
        imported = "ignore::pytest.PytestAssertRewriteWarning"  # of a plugin that this process has
        os._exit(int(pytest.main(["-x", "-q", "-W", imported, "-p", "no:cacheprovider", "-p", "no:faulthandler", *tests])))
    end = time.monotonic() + LONGEST
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def main() -> int:
    """Run the mutants; exit status 1 when the tests fail without any."""
    chosen = {name: tests for name, tests in MODULES.items() if not sys.argv[1:] or any(part in name for part in sys.argv[1:])}
    noticed = total = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("hyst_control", "hyst_plant_sim", "config", "test", "pyproject.toml"):
            source = ROOT / part
            if source.is_dir():
                shutil.copytree(source, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder / part)
        for module, tests in chosen.items():
            source, begin = (ROOT / module).read_text(encoding="utf-8"), time.monotonic()
            if not passes(folder, tests):
                print(f"{module}: {', '.join(tests)} fail without any mutant")
                return 1
            found = sorted(mutants(source, any(part in module for part in ENTRIES)), key=lambda mutant: mutant.begin)
            survivors = []
            for mutant in found:
                (folder / module).write_text(mutated(source, mutant), encoding="utf-8")
                if passes(folder, tests):
                    survivors.append(mutant.what)
            (folder / module).write_text(source, encoding="utf-8")
            noticed, total = noticed + len(found) - len(survivors), total + len(found)
            print(f"{module}: {len(found) - len(survivors)} of {len(found)} noticed, {time.monotonic() - begin:.0f} s", flush=True)
            for each in survivors:
                print(f"  survives: {each}", flush=True)
    print(f"{noticed} of {total} mutants noticed, {100 * noticed / max(total, 1):.0f} %")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
