# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals of the ROS graph as a client of Foxglove's websocket receives them, on the loopback."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from hyst_control.labs import foxglove_bridge
from hyst_control.records.stream.signal_message import Encoder, label_for

PROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1  # first byte of a binary frame; then subscription (4 bytes), time (8 bytes), payload


class Channels:
    """Rows that a bridge logs, without a server."""

    def __init__(self, monkeypatch):
        self.rows = []
        monkeypatch.setattr(foxglove_bridge.Bridge, "_channel", lambda bridge, topic, axes, units: self)

    def log(self, row):
        self.rows.append(row)


class Timers:
    def create_timer(self, period, callback):
        pass


def test_rows_are_thinned_to_the_rate_and_a_new_beginning_is_shown(monkeypatch):
    channels = Channels(monkeypatch)
    bridge = foxglove_bridge.Bridge(Timers(), None, rate=100.0)
    times = np.arange(2000) / 1000.0
    encoder = Encoder(label_for(["x", "y"], "um"))
    for part in np.split(times, 8):
        bridge.show("/measurement", encoder.encode(np.column_stack([part, part, -part])))
    assert [row["t"] for row in channels.rows] == pytest.approx(np.arange(200) / 100.0)
    assert channels.rows[7] == {"t": 0.07, "x": 0.07, "y": -0.07}
    bridge.show("/measurement", encoder.encode(np.array([[0.5, 1.0, 2.0]])))  # the loop was started anew
    assert channels.rows[-1] == {"t": 0.5, "x": 1.0, "y": 2.0}
    bridge.show("/measurement", b"\x00\x01\x00\x00 no signal")
    assert len(channels.rows) == 201


@pytest.mark.parametrize("words", [["--rate", "0"], ["--rate", "nan"]])
def test_an_impossible_rate_is_refused_in_one_line(words, capsys):
    assert foxglove_bridge.main(words) == 2
    assert capsys.readouterr().err.startswith("foxglove_bridge: --rate: must be above 0")


def test_a_missing_package_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert foxglove_bridge.main([]) == 2
    assert capsys.readouterr().err == "foxglove_bridge: foxglove-sdk is not installed: pip install foxglove-sdk\n"


def test_a_client_receives_the_signals_with_their_units(ros_context, domain):
    pytest.importorskip("foxglove", reason="pip install foxglove-sdk, as `make check-labs` does")
    connect = pytest.importorskip("websockets.sync.client", reason="as `make check-labs` installs").connect
    rclpy = pytest.importorskip("rclpy")
    from std_msgs.msg import Float64MultiArray

    node = rclpy.create_node("stage", context=ros_context)
    publisher = node.create_publisher(Float64MultiArray, "/stage/measurement", 10)
    encoder = Encoder(label_for(["x"], "mrad"))
    command = [sys.executable, "-m", "hyst_control.labs.foxglove_bridge", "--port", "0"]
    server = subprocess.Popen(command, env={**os.environ, "ROS_DOMAIN_ID": str(domain)}, stdout=subprocess.PIPE, text=True)
    try:
        address = server.stdout.readline().split()[-1]
        with connect(address, subprotocols=[PROTOCOL]) as client:
            channel = None
            for tick in range(3000):
                publisher.publish(encoder.encode(np.array([[0.02 * tick, 3.0]])))
                try:
                    frame = client.recv(timeout=0.02)
                except TimeoutError:
                    if channel is not None:  # the server may advertise a channel a moment before it takes subscriptions to it
                        subscription = {"id": tick, "channelId": channel["id"]}
                        client.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
                    continue
                if isinstance(frame, str) and (found := json.loads(frame))["op"] == "advertise":
                    [channel] = found["channels"]
                    assert json.loads(channel["schema"])["properties"]["x"] == {"type": "number", "description": "mrad"}
                elif isinstance(frame, bytes) and frame[0] == MESSAGE_DATA:
                    break
            assert channel is not None and channel["topic"] == "/stage/measurement"
            assert frame[0] == MESSAGE_DATA
            assert json.loads(frame[13:]).keys() == {"t", "x"} and json.loads(frame[13:])["x"] == 3.0
    finally:
        server.terminate()
        server.wait(30)
        node.destroy_node()
    assert server.returncode in (0, -15)
