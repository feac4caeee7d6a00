# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`make faults`: each command with its first, second, third … write, opened file, renaming, reading or allocation failing, until it passes.

Faults are made below Python, by a library that is preloaded (`fail_nth.c`), each in a forked process and a folder of its own. Whatever
fails, inputs and older outputs are whole afterwards, nothing is half-written, and one line says what happened.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
KINDS = {"write": 1, "open": 2, "rename": 3, "read": 4, "allocation": 5}
LARGE = 1 << 17
"""Bytes of an allocation that fails: arrays, not the interpreter's own, nor numpy's 64 KiB for a cast, of which the lack is a crash."""
ONCE, FOR_GOOD = 0, 1
OF_NUMPY = "init_gelsd failed init"
"""Line that numpy itself prints where it lacks memory for a least squares solution."""
MARK = "<!-- written by make faults -->"
"""In the page on safety before the table."""
LIMIT = 5000
"""Faults of a kind after which a command that has not passed never will."""


@dataclass(frozen=True)
class Case:
    """A command, and what it replaces."""

    words: tuple[str, ...]
    outputs: tuple[str, ...]
    old: bool = False  # True where an older output is there and must outlive a failure
    partial: bool = False  # True where what was written before the failure stays, and can be read


CASES = {
    "identify": Case(
        ("identify", "in/record", "--model", "linear", "--order", "1", "--output", "model.yaml", "--json", "fit.json"),
        ("model.yaml", "fit.json"),
        old=True,
    ),
    "report": Case(("plot", "in/record", "--output", "report.html"), ("report.html",), old=True),
    "import": Case(
        ("import", "in/long.csv", "--columns", "command=u[V],measurement=y[um]", "--rate", "1000", "--output", "bag"), ("bag",)
    ),
    "export": Case(("export", "in/record", "--to", "csv", "--output", "out"), ("out",)),
    "export C": Case(("export", "in/model.yaml", "--output", "c"), ("c",)),
    "simulate": Case(
        ("simulate", "in/model.yaml", "--excitation", "sine", "frequency=10", "amplitude=2", "duration=0.5", "--output", "sim"),
        ("sim",),
    ),
    "fleet": Case(
        ("fleet", "validate", "in/record", "in/second", "--model", "in/model.yaml", "--workers", "1", "--output", "study"),
        ("study",),
        partial=True,
    ),
    "record": Case(("record",), ("recorded",), partial=True),
}


def make_inputs(folder: Path) -> None:
    """Records of two units, a table and a model file."""
    import numpy as np

    from hyst_control.base.config_files import config_path
    from hyst_control.cli import main

    time = np.arange(2000) / 1000.0
    command = 20.0 + 15.0 * np.sin(2 * np.pi * 7.0 * time) + 3.0 * np.sin(2 * np.pi * 31.0 * time)
    rng = np.random.default_rng(3)
    (folder / "in").mkdir()
    os.chdir(folder)
    table = np.column_stack([time, command, 0.4 * command + 0.02 * rng.standard_normal(2000)])
    np.savetxt("in/table.csv", table, delimiter=",", header="t,u,y", comments="", fmt="%.6f")
    np.savetxt("in/long.csv", np.tile(table, (10, 1)), delimiter=",", header="t,u,y", comments="", fmt="%.6f")
    for name in ("record", "second"):
        assert (
            main(
                [
                    "import",
                    "in/table.csv",
                    "--columns",
                    "command=u[V],measurement=y[um]",
                    "--rate",
                    "1000",
                    "--output",
                    f"in/{name}",
                ]
            )
            == 0
        )
    shutil.copy(config_path("models/pea_hampi.yaml"), "in/model.yaml")


def record() -> int:
    """Write messages to a bag as the recorder does, without the middleware."""
    import numpy as np

    from hyst_control.base.errors import InputError
    from hyst_control.records.bags.bag_writer import BagWriter
    from hyst_control.records.stream.signal_message import Encoder

    encoder = Encoder("t[s],x[V]")
    try:
        writer = BagWriter("recorded")
    except InputError as error:
        preloaded().fail_nth(0, 0, b"", 0, 0)
        Path("flushed").write_text("0")
        print(error, file=sys.stderr)
        return 2
    writer.add_topic("command")
    written = 0
    try:
        for first in range(0, 2000, 100):
            rows = np.column_stack([np.arange(first, first + 100) / 1000.0, np.ones(100)])
            writer.write("command", encoder.encode(rows), first * 1_000_000)
            writer.flush()
            written = first + 100
        writer.close()
    except OSError as error:
        writer.abandon()
        preloaded().fail_nth(0, 0, b"", 0, 0)
        Path("flushed").write_text(str(written))
        print(f"recorded: {error.strerror}", file=sys.stderr)
        return 2
    return 0


def run(case: Case) -> int:
    """Exit status of a command in this process."""
    from hyst_control.cli import main

    return record() if case.words == ("record",) else main([*case.words, "--quiet"])


def forked(case: Case, folder: Path, arm: Callable[[], None]) -> tuple[int, str, bool]:
    """Exit status of a command in a forked process, what it says on the standard error, and whether a fault was met."""
    said, mark = folder.with_suffix(".said"), folder.with_suffix(".met")
    if (child := os.fork()) == 0:
        os.chdir(folder)
        for stream, path in ((1, os.devnull), (2, str(said))):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        status = 70
        try:
            arm()
            status = run(case)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 70
        except BaseException:
            import traceback

            preloaded().fail_nth(0, 0, b"", 0, 0)
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            met = preloaded().fail_count()
            preloaded().fail_nth(0, 0, b"", 0, 0)
            mark.write_text(str(met))
            os._exit(status)
    _, ended = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(ended), said.read_text(), mark.exists() and mark.read_text() != "0"


def preloaded() -> ctypes.CDLL:
    """The library, which is in this process already."""
    library = ctypes.CDLL(None)
    library.fail_nth.argtypes = [ctypes.c_int, ctypes.c_long, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_int]
    library.fail_count.restype = ctypes.c_long
    return library


def content(folder: Path) -> dict[str, str]:
    """Files below a folder, with a digest of each."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "tmp" not in path.relative_to(folder).parts
    }


def readable(folder: Path, output: str) -> str:
    """Why an output cannot be read; "" where it can."""
    import json

    from hyst_control.model_file import load_model
    from hyst_control.records.bags.bag_reader import read_bag

    path = folder / output
    flushed = int((folder / "flushed").read_text()) if (folder / "flushed").exists() else 2000
    if output == "recorded" and not flushed:
        return ""
    try:
        if (path / f"{output}_0.mcap").exists():
            rows = read_bag(path).signals["command"].values
            if output == "recorded" and len(rows) < flushed:
                return "rows that were flushed are lost"
        elif path.suffix == ".yaml":
            load_model(path)
        elif path.suffix == ".html" and not path.read_text(encoding="utf-8").rstrip().endswith("</html>"):
            return f"{output}: is cut off"
        elif path.suffix == ".json":
            json.loads(path.read_text())
    except Exception as error:
        return f"{output}: {type(error).__name__}: {error}"
    return ""


def faults_of(case: Case, status: int, said: str, before: dict[str, str], whole: set[str], folder: Path) -> list[str]:
    """Losses after a failure."""
    found = []
    after = content(folder)
    for name, digest in before.items():
        if name.startswith("in/") and after.get(name) != digest:
            found.append(f"input {name} is changed")
        elif case.old and name not in after:
            found.append(f"old {name} is lost")
    if status not in (0, 1, 2, 3):
        found.append(f"exit status {status}")
    lines = [line for line in said.strip().splitlines() if line != OF_NUMPY]
    if status and len(lines) != 1:
        found.append(f"{len(lines)} lines: {said.strip()[-300:]}")
    made = {name for name in after if name not in before and name != "flushed"}
    if left := {name for name in made if name.endswith(".part") or name.split("/")[0] not in case.outputs}:
        found.append(f"left over: {', '.join(sorted(left))}")
    if status == 0 and not case.partial and (missing := whole - set(after)):
        found.append(f"exit status 0 without {', '.join(sorted(missing))}")
    if status and not case.partial and not case.old and made - left and made != whole:
        found.append(f"half of the output: {', '.join(sorted(made)[:3])}")
    found += [reason for output in case.outputs if (folder / output).exists() and (reason := readable(folder, output))]
    return found


def sweep(name: str, kind: str, persistence: int, inputs: Path, most: int = LIMIT) -> tuple[int, list[str]]:
    """Number of faults of a kind that a command met, one run each, and what they cost."""
    case, tried, lost = CASES[name], 0, []
    with tempfile.TemporaryDirectory() as base:

        def attempt(number: int) -> tuple[Path, dict[str, str], int, str, bool]:
            folder = Path(base).resolve() / f"run{number}"
            shutil.copytree(inputs, folder)
            if case.old:
                for output in case.outputs:
                    shutil.copy(inputs.with_name("old") / output, folder / output)
            (folder / "tmp").mkdir()
            before = content(folder)
            os.environ["TMPDIR"] = tempfile.tempdir = str(folder / "tmp")
            try:
                ended = forked(
                    case,
                    folder,
                    lambda: preloaded().fail_nth(KINDS[kind] if number else 0, number, f"{folder}/".encode(), LARGE, persistence),
                )
            finally:
                tempfile.tempdir = None
                os.environ.pop("TMPDIR")
            return folder, before, *ended

        folder, before, status, said, _ = attempt(0)
        assert status == 0, said
        whole = set(content(folder)) - set(before) if not case.old else set(case.outputs)
        for number in range(1, most + 1):
            folder, before, status, said, met = attempt(number)
            if not met and status == 0:
                break
            tried += 1
            lost += [f"{name}, {kind} {number}: {fault}" for fault in faults_of(case, status, said, before, whole, folder)]
            shutil.rmtree(folder)
    return tried, lost


def prepared(base: Path, names: Iterable[str]) -> Path:
    """Folder of the inputs; every command has run once, so that what it imports and compiles is there."""
    inputs, old = base / "inputs", base / "old"
    inputs.mkdir()
    make_inputs(inputs)
    shutil.copytree(inputs, old)
    os.chdir(old)
    for name in names:
        assert run(CASES[name]) == 0, name
    os.chdir(base)
    return inputs


def main(names: list[str], most: int = LIMIT) -> int:
    """Print the table, and what was lost."""
    sys.path[:0] = [str(ROOT), str(ROOT / "test")]
    from one_process import one_thread

    from hyst_control.base.parallel import Workers, compute_serially

    compute_serially()
    Workers.open = one_thread  # type: ignore[method-assign, assignment]
    lost: list[str] = []
    with tempfile.TemporaryDirectory() as base:
        out, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        inputs = prepared(Path(base).resolve(), names or CASES)
        sys.stdout.flush()
        os.dup2(out, 1)
        print(f"{'command':10} {'fault':12} {'lasting':8} {'tried':>6} {'lost':>5}")
        counted: dict[str, list[str]] = {}
        for name in names or CASES:
            for kind in KINDS:
                for persistence in (ONCE, FOR_GOOD):
                    tried, found = sweep(name, kind, persistence, inputs, most)
                    print(f"{name:10} {kind:12} {'yes' if persistence else 'no':8} {tried:6d} {len(found):5d}", flush=True)
                    lost += found
                    counted.setdefault(name, []).append(f"{tried}{f', {len(found)} lost' if found else ''}")
    print(*lost, f"lost: {len(lost)}", sep="\n")
    if most == LIMIT:
        write_table(counted)
    return bool(lost)


def write_table(counted: dict[str, list[str]]) -> None:
    """Write the numbers of faults of these commands, once and lasting, into the page on safety, where others keep theirs."""
    page = ROOT / "docs" / "safety.md"
    before, mark, rest = page.read_text(encoding="utf-8").partition(MARK)
    old, end = rest[: rest.index("\n\n", 2)], rest[rest.index("\n\n", 2) :]
    rows = {line.split(" | ")[0].lstrip("| "): line for line in old.splitlines()[4:]}
    for name, numbers in counted.items():
        cells = [f"{once}; {lasting}" for once, lasting in zip(numbers[::2], numbers[1::2], strict=True)]
        rows[name] = f"| {name} | {' | '.join(cells)} |"
    head = [f"| command | {' | '.join(KINDS)} |", "|---" * (len(KINDS) + 1) + "|"]
    lines = "\n".join(head + [rows[name] for name in CASES if name in rows])
    page.write_text(f"{before}{mark}\n\n{lines}{end}", encoding="utf-8")


def preload() -> None:
    """Begin again with the library in the process, compiled where that is not so yet."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "fail_nth.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(HERE / "fail_nth.c"), "-ldl"], check=True)
        alone = {"LD_PRELOAD": str(library), "OPENBLAS_NUM_THREADS": "1", "HYST_FAULTS": "1"}
        sys.exit(subprocess.run([sys.executable, __file__, *sys.argv[1:]], env={**os.environ, **alone}).returncode)


if __name__ == "__main__":
    if "HYST_FAULTS" not in os.environ:
        preload()
    words = sys.argv[1:]
    most = int(words.pop(0)) if words and words[0].isdigit() else LIMIT
    sys.exit(main(words, most))
