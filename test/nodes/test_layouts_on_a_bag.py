"""The layouts for PlotJuggler and Foxglove, on a bag that the nodes recorded and `hyst export` rewrote: every curve has its points."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from loop_case import RATE, parameters
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import DEFAULT, node_class
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.tables.exporting import export_record

ROOT = Path(__file__).resolve().parents[2]
LIVE = {"/residual", "/gap"}
"""Topics of the live twin, which is not part of the recorded loop."""


@pytest.fixture
def channels(tmp_path, ros_context):
    """Log times (N,) in s and all data (N, C) by topic, as another library reads them from the exported file."""
    settings = parameters(tmp_path, 400, recorder={"merge": 50})
    nodes = [
        node_class(name)(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in given.items()])
        for name in DEFAULT
        for given in [settings[name]]
    ]
    assert run(nodes, ros_context, timeout=120.0) == 0
    export_record(read_bag(tmp_path / "bag"), tmp_path / "rows", "mcap")
    found: dict[str, tuple[list[float], list[np.ndarray]]] = {}
    with AnyReader([tmp_path / "rows"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time, raw in reader.messages():
            times, rows = found.setdefault(connection.topic, ([], []))
            times.append(time * 1e-9)
            rows.append(reader.deserialize(raw, connection.msgtype).data)
    return {topic: (np.array(times), np.array(rows)) for topic, (times, rows) in found.items()}


def drawn(channels, topic, index):
    """Points of a curve as a player draws them: one per message, at its log time."""
    times, rows = channels[topic]
    np.testing.assert_allclose(times, rows[:, 0], atol=1e-9)  # the clock of the player is that of the samples
    return times, rows[:, int(index)]


def check(channels, curves, loops):
    shown = {topic for topic, _ in curves}
    assert len(shown - LIVE) == 5
    for topic, index in curves:
        if topic not in LIVE:
            times, values = drawn(channels, topic, index)
            assert len(times) == 400 and np.isfinite(values).all()
            np.testing.assert_allclose(np.diff(times), 1 / RATE, atol=1e-9)
    assert loops
    for over, along in loops:
        (x_times, x), (y_times, y) = drawn(channels, *over), drawn(channels, *along)
        np.testing.assert_array_equal(x_times, y_times)  # PlotJuggler draws no loop of two time axes
        assert np.ptp(x) > 1.0 and np.ptp(y) > 1.0


def test_both_layouts_have_their_points(channels):
    layout = ElementTree.parse(ROOT / "config/plotjuggler/loop.xml")
    split = re.compile(r"(/\w+)/data\[(\d)\]").fullmatch
    curves = [split(curve.get("name")).groups() for curve in layout.iter("curve") if "curve_x" not in curve.attrib]
    loops = [
        (split(curve.get("curve_x")).groups(), split(curve.get("curve_y")).groups())
        for curve in layout.iter("curve")
        if "curve_x" in curve.attrib
    ]
    check(channels, curves, loops)

    panels = json.loads((ROOT / "config/foxglove/loop.json").read_text())["configById"].values()
    split = re.compile(r"(/\w+)\.data\[(\d)\]").fullmatch
    curves = [split(path["value"]).groups() for panel in panels for path in panel.get("paths", [])]
    loops = [
        (split(panel["xAxisPath"]["value"]).groups(), split(path["value"]).groups())
        for panel in panels
        if "xAxisPath" in panel
        for path in panel["paths"]
    ]
    check(channels, curves, loops)
