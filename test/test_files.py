# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs: whole or not at all, through links and devices, and never over what is read."""

import errno
import json
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.base.files import appearing, check_outputs, check_writable, read_json, replacing, write_json, write_text
from hyst_control.cli import main
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag


def small_bag(path):
    time = np.arange(50) * 1e-3
    write_bag(path, Record({name: Signal(time, np.zeros((50, 1)), ("x",), "V") for name in ("command", "measurement")}, "made"))
    return path


def test_a_symbolic_link_is_written_through(tmp_path):
    target, link, chain = tmp_path / "deep" / "real.json", tmp_path / "link.json", tmp_path / "chain.json"
    target.parent.mkdir()
    link.symlink_to("deep/real.json")
    chain.symlink_to("link.json")
    for path in (link, chain):
        check_writable(path)
        write_text(path, str(path))
        assert path.is_symlink() and target.read_text() == str(path)
    assert os.listdir(target.parent) == ["real.json"]
    loop = tmp_path / "loop"
    loop.symlink_to("loop")
    for act in (check_writable, lambda path: write_text(path, "x")):
        with pytest.raises(InputError, match="too many symbolic links"):
            act(loop)


def test_devices_and_pipes_stay_what_they_are(tmp_path):
    check_writable("/dev/null")
    write_json("/dev/null", {"a": 1})
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    with pytest.raises(InputError, match=r"no room for /dev/full \(No space left on device\)"):
        write_text("/dev/full", "x" * 100_000)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    heard = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    write_text(pipe, "through")
    reader.join(10)
    assert heard == ["through"] and stat.S_ISFIFO(os.stat(pipe).st_mode)


@pytest.mark.parametrize("buffered", [False, True])
def test_the_standard_output_by_its_name_takes_the_json_and_keeps_what_it_has(tmp_path, buffered):
    """Text that Python had still buffered was written over the JSON."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment |= {} if buffered else {"PYTHONUNBUFFERED": "1"}
    out = tmp_path / "out.txt"
    with open(out, "w") as file:
        words = [sys.executable, "-c", "from hyst_control.cli import main; raise SystemExit(main())", "excite", "--list"]
        assert subprocess.run([*words, "--json", "/dev/stdout"], stdout=file, env=environment, check=False).returncode == 0
    text = out.read_text()
    assert '"schema": "hyst_control/excitations"' in text and "cosine_ramp start stop duration" in text


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_the_umask_counts_and_permissions_stay(tmp_path, mask):
    path = tmp_path / "a.txt"
    before = os.umask(mask)
    try:
        write_text(path, "new")
        assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
        path.chmod(0o640)
        write_text(path, "again")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_what_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), replacing(path) as file:
        file.write(b"half")
        raise RuntimeError
    with pytest.raises(KeyboardInterrupt), replacing(path) as file:
        raise KeyboardInterrupt
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]
    with pytest.raises(InputError, match="is a directory"):
        write_text(tmp_path, "x")


def test_what_cannot_be_written_is_told_before(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="is a directory: give the name of a file"):
        check_writable(tmp_path)
    with pytest.raises(InputError, match="its folder does not exist or cannot be written: create it first"):
        check_writable(tmp_path / "none" / "a.txt")
    check_outputs({"--output": tmp_path / "a.txt"}, ["a\0b"])  # a text that no file can be called, as a signal's name may be
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match="/dev/null: cannot be written: choose another name"):
        check_writable("/dev/null")


def test_a_name_that_is_taken_meanwhile_is_one_line(tmp_path):
    with pytest.raises(InputError, match="Is a directory: choose a file name that can be written"), replacing(tmp_path / "a"):
        (tmp_path / "a").mkdir()
    assert os.listdir(tmp_path) == ["a"]


def test_names_that_are_no_text_are_written(tmp_path):
    write_json(tmp_path / "a.json", {"bag": "run\udcff"})
    assert json.loads((tmp_path / "a.json").read_text()) == {"bag": "run\udcff"}


def test_an_output_that_is_read_or_given_twice_is_refused(tmp_path):
    bag = small_bag(tmp_path / "bag")
    (tmp_path / "link").symlink_to(bag)
    os.link(bag / "bag_0.mcap", tmp_path / "hard.mcap")
    for output in (bag, bag / "bag_0.mcap", bag / "new.yaml", tmp_path / "link" / "new.yaml", tmp_path / "other" / ".." / "bag"):
        with pytest.raises(InputError, match="is read as well|lies within"):
            check_outputs({"--output": output}, [bag])
    with pytest.raises(InputError, match="is read as well"):
        check_outputs({"--output": tmp_path / "hard.mcap"}, [bag / "bag_0.mcap"])
    with pytest.raises(InputError, match="--report .*: is --json as well"):
        check_outputs({"--json": tmp_path / "a", "--report": tmp_path / "b" / ".." / "a"})
    check_outputs(
        {"--json": "-", "--report": "/dev/null", "--augmented": "/dev/null", "--output": tmp_path / "bag2", "--page": None},
        [bag, "hampi", None],
    )


def commands(folder):
    bag, model = str(small_bag(folder / "bag")), str(folder / "model.yaml")
    table = folder / "t.csv"
    table.write_text("1,2\n3,4\n")
    inside, file = f"{bag}/new.yaml", f"{bag}/bag_0.mcap"
    return [
        ["identify", bag, "--model", "hampi", "--output", file],
        ["identify", bag, "--model", "hampi", "--output", inside],
        ["identify", bag, "--model", "hampi", "--output", model, "--json", model],
        ["diagnose", bag, "--model", model, "--json", file],
        ["diagnose", bag, "--model", model, "--report", str(folder / "x"), "--augmented", str(folder / "x")],
        ["simulate", model, bag, "--output", f"{bag}/simulated"],
        ["import", str(table), "--columns", "command=1[V]", "--rate", "1", "--output", str(folder / "out"), "--json", str(table)],
        ["validate", model, bag, "--json", inside],
        ["compare", model, bag, "--json", inside],
        ["excite", "sine", "frequency=1", "amplitude=1", "--output", str(folder / "o.csv"), "--json", str(folder / "o.csv")],
    ]


@pytest.mark.parametrize("index", range(10))
def test_every_command_refuses_before_it_reads(index, tmp_path, capsys):
    """The model file does not exist: a command that reads first says that instead."""
    words = commands(tmp_path)[index]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and ("read as well" in line or "lies within" in line or " as well: give every" in line)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_terminal_that_knows_ascii_alone_gets_a_line(tmp_path):
    words = [sys.executable, "-c", "from hyst_control.cli import main; raise SystemExit(main())"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}
    for name in ("µ.csv", "a\udcffb.csv"):
        given = [*words, "excite", "sine", "frequency=1", "amplitude=1", "--output", str(tmp_path / name), "--rate", "100"]
        done = subprocess.run(given, env=environment, capture_output=True, check=False)
        assert done.returncode == 0 and b"Traceback" not in done.stderr and b"written: " in done.stdout
        again = subprocess.run(given, env=environment, capture_output=True, check=False)
        assert again.returncode == 2 and again.stderr.count(b"\n") == 1 and b"exists already" in again.stderr


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[1]", b"3", b"\xff\xfe", b'{"kind":' + b"[" * 100_000], ids=lambda text: repr(text[:8])
)
def test_a_json_file_that_is_none_is_refused_in_one_line(text, tmp_path):
    (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(InputError) as refused:
        read_json(tmp_path / "a.json")
    assert str(refused.value).startswith(f"{tmp_path / 'a.json'}: ") and "\n" not in str(refused.value)


def test_a_json_file_that_is_missing_or_a_folder_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(InputError, match="cannot be read"):
            read_json(path)
    write_json(tmp_path / "a.json", {"kept": [1.5]})
    assert read_json(tmp_path / "a.json") == {"kept": [1.5]}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("labels.json", ("blind-test", "--seed", "7", "--count", "1", "--output", ".")),
        ("labels.json", ("blind-test", "--injected", "--seed", "7", "--count", "1", "--output", ".")),
        ("summary.json", ("fleet", "identify", "bag", "--output", ".")),
        ("result.json", ("reproduce", "page", "--results", "result.json", "--page", "page.md")),
    ],
)
@pytest.mark.parametrize("text", ["[" * 100_000, "{}", "[]", '{"schema": "hyst_control/table", "source": "reproduce mhl"}'])
def test_a_run_is_not_taken_up_from_a_damaged_file(name, words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text)
    assert main(list(words)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [each.name for each in tmp_path.iterdir()] == [name] and (tmp_path / name).read_text() == text


def test_a_folder_that_cannot_be_made_is_told_by_its_own_name(tmp_path, monkeypatch):
    def refused(path, *_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), path)

    monkeypatch.setattr(os, "mkdir", refused)
    with pytest.raises(InputError) as told, appearing(tmp_path / "bag"):
        pass
    assert str(told.value) == f"{tmp_path / 'bag'}: Read-only file system: choose a folder that can be written"


def test_an_open_file_of_the_process_can_be_written_where_its_folder_cannot(tmp_path, monkeypatch):
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, *more: Path(path).name != "fd" and may(path, *more))
    with open(tmp_path / "out.txt", "wb") as file:
        check_writable(f"/dev/fd/{file.fileno()}")
