# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a first hour end in one line that names the remedy."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.base.config_files import config_path
from hyst_control.cli import main
from hyst_control.records.excitation.excitation import KINDS
from hyst_control.records.excitation.parameters import described
from hyst_control.records.tables.importing import import_records, parse_columns

MODEL = str(config_path("models/pea_hampi.yaml"))
COMMAND = np.repeat([0.0, 40.0, 0.0, 40.0], 500)


def told(capsys, *words):
    """The one line of a refused command."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            status = main(list(map(str, words)))
        except SystemExit as error:
            status = error.code
    line = capsys.readouterr().err.strip()
    assert status == 2 and "\n" not in line, line
    return line


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "record"
    hc.from_arrays(COMMAND, 0.1 * COMMAND, rate=1000).save(path)
    return path


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "lab.csv"
    np.savetxt(path, np.column_stack([COMMAND, 0.1 * COMMAND]), delimiter=",", header="u,y", comments="")
    return path


@pytest.mark.parametrize(
    "words", [["identify"], ["plot"], ["check"], ["edit"], ["diagnose", "--model", MODEL], ["validate", MODEL], ["simulate", MODEL]]
)
def test_a_table_in_the_place_of_a_bag_is_to_be_imported(words, table, tmp_path, capsys):
    command, *others = words
    files = [table, *others] if "--model" in others else [*others, table]
    more = ["--output", tmp_path / "out"] if command == "simulate" else []
    assert f"hyst import {table}" in told(capsys, command, *files, *more)


def test_a_gap_that_is_too_long_to_fill_is_not_promised_to_be_filled(tmp_path, capsys):
    path, columns = tmp_path / "gap.csv", "time=1[s],command=2[V],measurement=3[um]"
    rows = np.column_stack([np.arange(2000) / 1000, COMMAND, COMMAND])

    def refused(kept, *options):
        np.savetxt(path, kept, delimiter=",")
        return told(capsys, "import", path, "--output", tmp_path / "out", "--columns", columns, *options)

    def filled():
        return [len(record) for record in import_records(path, parse_columns(columns), None, resample=0.0)]

    assert "--resample interpolates them" in refused(np.delete(rows, np.s_[500:509], axis=0)) and filled() == [2000]
    assert "too many in a row for --resample (at most 9)" in refused(np.delete(rows, np.s_[500:510], axis=0))
    assert filled() == [500, 1490]
    rows[100:109, 2] = np.nan
    assert "--resample interpolates such rows" in refused(rows) and filled() == [2000]
    rows[109, 2] = np.nan
    assert "too many in a row for --resample (at most 9): --allow-gaps leaves such rows out" in refused(rows)
    assert filled() == [100, 1890]
    early = refused(np.delete(rows, np.s_[5:110], axis=0), "--resample")
    assert "gaps of more than 9 rows, the first before row 5, leave 2 parts, the shortest of 5 rows" in early
    with pytest.raises(SystemExit):
        main(["import", "--help"])
    assert "gaps of at most 9 rows" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    "columns, missing",
    [("cmd=1[V],measurement=2[um]", "has no command, only cmd, measurement"), ("command=1[V]", "has no measurement")],
)
def test_an_import_without_command_or_measurement_is_told(columns, missing, table, tmp_path, capsys):
    assert main(["import", str(table), "--columns", columns, "--rate", "1000", "--output", str(tmp_path / "bag")]) == 0
    assert missing in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        "diagnose --baseline yesterday today",
        "plot --signals command measurement record",
        "compare --bags record model.yaml",
        "import --resample jit.csv --columns x",
        "tune --at 100 model.yaml",
        "excite sine frequency=10 --output z.npy amplitude=20",
    ],
)
def test_an_option_that_took_the_files_is_told(words, capsys):
    assert ": put the files before the options: see hyst" in told(capsys, *words.split())


@pytest.mark.parametrize(
    "words", ["diagnose", "tune model.yaml extra", "identify record --foo 3", "edit a --outliers --low-pass b"]
)
def test_other_words_that_do_not_fit_are_not_laid_on_the_order(words, capsys):
    assert "before the options" not in told(capsys, *words.split())


def test_the_topics_of_a_bag_are_named_where_one_is_missing(tmp_path, capsys):
    words = ["raster", "width=1", "height=1", "lines=2", "line_time=0.05", "--axes", "2", "--unit", "mrad"]
    assert main(["excite", *words, "--output", str(tmp_path / "scan")]) == 0
    assert "has no topic command (topics: reference)" in told(
        capsys, "simulate", config_path("models/fsm_mhl.yaml"), tmp_path / "scan", "--output", tmp_path / "out"
    )


def test_a_truth_plant_is_told_from_a_model(tmp_path, capsys):
    assert "is a reference simulation, for the node plant and hyst learn --plant" in told(
        capsys, "tune", config_path("plants/pea.yaml")
    )
    (tmp_path / "other.yaml").write_text("a: 1\n")
    assert told(capsys, "tune", tmp_path / "other.yaml").endswith("give what hyst identify wrote")


def test_a_bag_or_table_in_the_place_of_a_model_to_export_is_told(bag, table, capsys):
    assert "or --to csv, mat, mcap or parquet for a bag" in told(capsys, "export", bag)
    table.write_text(table.read_text() * 10)
    assert "is no YAML of keys and values, but one text of" in told(capsys, "export", table)


def test_edit_names_its_own_option_and_says_where_a_filter_rings(bag, tmp_path, capsys):
    assert "threshold (--outliers): must be > 0" in told(capsys, "edit", bag, "--outliers", "-3", "--output", tmp_path / "out")
    assert main(["edit", str(bag), "--resample", "400", "--output", str(tmp_path / "out")]) == 0
    ringing = capsys.readouterr().out
    low = float(ringing.partition("the command now runs from ")[2].split()[0])
    assert low == pytest.approx(hc.read_bag(tmp_path / "out").command.min(), rel=1e-3) and low < -0.4
    smooth = 20 - 20 * np.cos(2 * np.pi * np.arange(2000) / 1000)
    assert not hc.from_arrays(smooth, smooth, rate=1000).resample(400).filter(low_pass=100).notes


def test_kinds_of_signals_are_listed_with_unit_and_meaning_of_every_parameter(capsys):
    assert main(["excite", "--list"]) == 0
    listed = capsys.readouterr().out
    assert "      frequency [Hz]: Frequency\n" in listed and "      lowest [V]: Lowest command\n" in listed
    assert all(described(name, "offset").meaning in listed for name in ("raster", "rest", "step")) and len(KINDS) > 10


@pytest.mark.parametrize(
    "words, said",
    [
        ("sine frequency=10 amplitude=1e400", "the signal is empty or not finite"),
        ("sine frequency=-10 amplitude=1", "frequency: must be >= 0 Hz, got -10 Hz"),
        ("steps lowest=5 highest=1 hold=0.1 count=3", "lowest: must be <= highest (1), got 5"),
        ("diagnostic lowest=5 highest=1", "lowest: must be <= highest (1), got 5"),
    ],
)
def test_values_of_no_signal_are_refused_in_one_line(words, said, tmp_path, capsys):
    assert said in told(capsys, "excite", *words.split(), "--output", tmp_path / "out.npy")


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files")
@pytest.mark.parametrize("output", ["drive.csv", "drive"])
def test_a_full_disk_is_told_with_the_output(output, tmp_path):
    limited = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (2**17, 2**17)); "
    words = ["excite", "sine", "frequency=10", "amplitude=2", "duration=2", "--output", str(tmp_path / output)]
    code = f"{limited}from hyst_control.cli import main; raise SystemExit(main(sys.argv[1:]))"
    ended = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60)
    line = f"no room for {tmp_path / output} (File too large): free space or choose another folder"
    assert ended.returncode == 2 and ended.stderr.strip() == f"hyst excite: {line}"
    assert not list(tmp_path.iterdir())
