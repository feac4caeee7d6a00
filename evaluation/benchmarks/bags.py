# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rates at which bags are written and read."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from evaluation.benchmarks import limits
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder
from hyst_control.reporting.tables import Limit, Table

MESSAGES, ROWS = 24_000, 50
"""Per topic: 1.2 million samples, a minute at 20 kHz, in blocks of 50."""
REPEATS = 5


def run(table: Table) -> None:
    """Write and read a bag of two topics; messages of both topics per second, medians."""
    labels = {"/command": "t[s],x[V]", "/measurement": "t[s],x[um]"}
    rng = np.random.default_rng(0)
    blocks = rng.normal(size=(MESSAGES, ROWS, 2))
    blocks[:, :, 0] = 5e-5 * np.arange(MESSAGES * ROWS).reshape(MESSAGES, ROWS)
    writing, reading = [], []
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(REPEATS):
            path = Path(folder) / f"bag{repeat}"
            encoders = {topic: Encoder(label) for topic, label in labels.items()}
            begin = time.perf_counter()
            with BagWriter(path) as writer:
                for index in range(MESSAGES):
                    for topic, encoder in encoders.items():
                        writer.write(topic, encoder.encode(blocks[index]), index * 2_500_000)
            writing.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            record = read_bag(path)
            reading.append(time.perf_counter() - begin)
            assert len(record.signals["command"].time) == MESSAGES * ROWS
        written, read = limits.copying(path)
    case = f"2 topics of {MESSAGES} messages of {ROWS} rows"
    for quantity, spent, bare in (("bag_write_rate", writing, written), ("bag_read_rate", reading, read)):
        rate, limit = 2 * MESSAGES / np.median(spent), Limit(2 * MESSAGES / bare.value, bare.of)
        table.add("bags", case, "hyst", quantity, "messages/s", rate, n=REPEATS, limit=limit)
    table.add("bags", case, "hyst", "bag_read_time", "s", np.median(reading), n=REPEATS, limit=read)
