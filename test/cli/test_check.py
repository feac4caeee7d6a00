# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst check`: what was taken out of a bag is what it says is missing."""

from __future__ import annotations

import json
import re
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.cli import main
from hyst_control.diagnose import workflow
from hyst_control.model_file import load_model
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.losses import account
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.signal_message import Encoder

LABELS = {"/command": "t[s],x[V]", "/measurement": "t[s],x[um]"}


def written(path, ticks, values=None, labels=LABELS):
    """A bag whose measurement has these ticks of 1 kHz, and whose command has all."""
    with BagWriter(path) as writer:
        for topic, label in labels.items():
            encoder = Encoder(label)
            for index in range(200) if topic == "/command" else ticks:
                value = 1.0 if values is None or topic == "/command" else values[index]
                writer.write(topic, encoder.encode(np.array([[index * 1e-3, value]])), 10**9 + index * 10**6)
    return path


def told(capsys, *words):
    status = main(["check", *map(str, words)])
    return status, capsys.readouterr().out


def test_a_whole_bag_is_whole(tmp_path, capsys):
    status, out = told(capsys, written(tmp_path / "bag", range(200)))
    assert status == 0 and "bag: whole" in out and "missing" not in out and "200 rows at 1000 Hz, 0 to 0.199 s" in out


def test_what_was_taken_out_is_counted(tmp_path, capsys):
    ticks = [tick for tick in range(200) if tick not in (3, 50, 51, 52, 120)]
    values = np.ones(200)
    values[7:9] = np.nan
    path = written(tmp_path / "bag", ticks, values)
    status, out = told(capsys, path, "--json", tmp_path / "check.json")
    assert status == 3 and "not whole" in out and "5 ticks missing (at most 3 in a row), 2 rows that are no numbers" in out
    rows = {(row["case"], row["quantity"]): row["value"] for row in json.loads((tmp_path / "check.json").read_text())["rows"]}
    assert rows["measurement", "missing"] == 5 and rows["measurement", "invalid"] == 2 and rows["command", "missing"] == 0


def test_of_a_damaged_bag_it_says_what_is_still_good(tmp_path, capsys):
    path = written(tmp_path / "bag", range(200))
    [file] = path.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    status, out = told(capsys, path)
    good = int(re.search(r"(\d+) messages up to its last whole chunk were read", out)[1])
    assert status == 3 and 0 < good < 400 and sum(map(int, re.findall(r"(\d+) rows at", out))) == good


def test_one_bag_that_is_not_whole_is_enough(tmp_path, capsys):
    status, out = told(capsys, written(tmp_path / "one", range(200)), written(tmp_path / "other", [*range(90), *range(95, 200)]))
    assert status == 3 and out.count(": whole") == 1 and out.count(": not whole") == 1


@pytest.mark.parametrize(("there", "missing"), [("/command", "measurement"), ("/measurement", "command")])
def test_a_bag_without_command_or_measurement_is_not_whole(there, missing, tmp_path, capsys):
    status, out = told(capsys, written(tmp_path / "bag", range(200), labels={there: LABELS[there]}))
    assert status == 3 and "bag: not whole" in out and f"has no {missing}: record it" in out


@pytest.mark.parametrize(("first", "alone"), [(5_000_000, 0.199), (50, 0.05)])
def test_command_and_measurement_of_different_times_are_not_whole(first, alone, tmp_path, capsys):
    status, out = told(capsys, written(tmp_path / "bag", range(first, first + 200)))
    assert status == 3 and f"command has no measurement beside it for {alone} s of 0.199 s: the times are of two clocks" in out


def test_only_what_is_lost_counts_of_the_notes(tmp_path, capsys):
    """Not that messages have no layout, that rows came twice, or that a recorder met one topic a little later."""
    with BagWriter(tmp_path / "bag") as writer:
        for topic in LABELS:
            for index in range(200):
                plain = b"\x00\x01\x00\x00" + struct.pack("<IIIId", 0, 0, 1, 0, 1.0)  # without a layout
                writer.write(topic, plain, 10**9 + index * 10**6)
    status, out = told(capsys, tmp_path / "bag")
    assert status == 0 and "bag: whole" in out and "note" in out and "messages without a layout" in out
    status, out = told(capsys, written(tmp_path / "late", [*range(5, 200), *range(190, 200)]))
    assert status == 0 and "late: whole" in out and "10 rows were sent twice and kept once" in out


@settings(max_examples=50, deadline=None)
@given(st.sets(st.integers(1, 298), max_size=120), st.floats(0.0, 0.3), st.sampled_from(["layout", "receive"]))
def test_missing_rows_are_counted_whatever_the_jitter(left_out, jitter, timing):
    ticks = np.setdiff1d(np.arange(300), list(left_out)).astype(float)
    noise = np.random.default_rng(1).uniform(-jitter / 2, jitter / 2, len(ticks))
    signal = Signal((ticks + noise) * 2e-4, np.ones((len(ticks), 1)), ("x",), "um", timing)
    if np.median(np.diff(ticks)) > 1:
        return  # of every second row nobody knows that others are missing
    [found] = account(Record({"measurement": signal}, "bag"))
    assert found.missing == len(left_out) and found.rows == 300 - len(left_out)
    assert found.longest == max(np.diff(ticks)) - 1


def test_no_bag_is_one_line(tmp_path, capsys):
    assert main(["check", str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("count", [0, 1])
def test_a_topic_of_next_to_nothing(count):
    [found] = account(Record({"measurement": Signal(np.zeros(count), np.zeros((count, 1)), ("x",), "um")}, "bag"))
    assert found.rows == count and found.whole == bool(count)


def lossy(path):
    """A bag of a lag of first order that lacks four rows of its measurement."""
    random, command, answer = np.random.default_rng(1), [], [0.0]
    for index in range(2000):
        command.append(20.0 + 15.0 * np.sin(2 * np.pi * 7e-3 * index) + 3.0 * np.sin(2 * np.pi * 31e-3 * index))
        answer.append(answer[-1] + 0.2 * (0.4 * command[-1] - answer[-1]))
    with BagWriter(path) as writer:
        for topic, label in LABELS.items():
            encoder, values = Encoder(label), command if topic == "/command" else answer
            for index in range(2000):
                if topic == "/command" or index not in (700, 701, 702, 1100):
                    row = [index * 1e-3, values[index] + 0.01 * random.standard_normal()]
                    writer.write(topic, encoder.encode(np.array([row])), 10**9 + index * 10**6)
    return path


def test_identification_and_diagnosis_tell_what_their_records_lack(tmp_path, capsys, monkeypatch):
    bag, model = lossy(tmp_path / "bag"), tmp_path / "model.yaml"
    words = ["--model", "linear", "--order", "1", "--allow-gaps", "--output", str(model), "--json", str(tmp_path / "fit.json")]
    assert main(["identify", str(bag), *words]) == 0
    assert "measurement: 4 of 2000 rows are missing, at most 3 in a row" in capsys.readouterr().out
    monkeypatch.setattr(workflow, "diagnosed", lambda *given, **settings: ({"notes": ["of the diagnosis"]}, None, None))
    monkeypatch.setattr(workflow, "in_words", str)  # what takes half a minute has nothing to do with it
    gap = workflow.diagnose_records([read_bag(bag)], load_model(model)).document
    assert "measurement: 4 of 2000 rows are missing, at most 3 in a row" in gap["notes"][0]
    for report in (json.loads((tmp_path / "fit.json").read_text()), gap):
        lost = {row["topic"]: row for row in report["losses"]}
        assert [lost["measurement"][key] for key in ("sent", "received", "missed")] == [2000, 1996, 4]
        assert lost["command"]["missed"] == 0


@pytest.mark.parametrize("topics", [(), tuple(LABELS)])
def test_a_bag_in_which_nothing_arrived_is_empty(tmp_path, topics, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        for topic in topics:
            writer.add_topic(topic)
    assert main(["check", str(tmp_path / "bag")]) == 2
    where = f" on {', '.join(topics)}" if topics else ""
    assert f"bag: is empty: nothing was recorded{where}: record while the nodes run and publish" in capsys.readouterr().err
