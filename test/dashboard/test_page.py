# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A page of a loop that exists only here: its status and events come from the diagnostics, and nothing is wider than a telephone."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import browser as browsers
import numpy as np
import pytest
from no_actions import NoActions

from hyst_control.dashboard.live_state import LOST_AFTER, LiveState, NodeState

pages = pytest.importorskip("hyst_control.dashboard.page", reason="the extra dashboard, which make env installs")

AXES = ("x", "y")
SLOW = 600.0
"""s that a busy machine may take until it looks at rows and diagnostics."""
SEEN = """() => {
  const named = name => Bokeh.documents[0].get_model_by_name(name).text.replace(/<[^>]*>/g, " ");
  const wide = [], edge = document.documentElement.clientWidth + 1;
  const look = parent => [...parent.children, ...(parent.shadowRoot ? parent.shadowRoot.children : [])].forEach(child => {
    const box = child.getBoundingClientRect();
    if (child.className.startsWith?.("bk-GlyphRenderer")) return;  // what is drawn is cut off by its frame
    if (box.width > 0 && (box.right > edge || box.left < -1)) wide.push(child.tagName + " " + child.className + ": " + box.right);
    look(child);
  });
  look(document.body);
  return { status: named("status"), events: named("events"), numbers: named("numbers"), nodes: named("nodes"), wide,
           scrolls: document.documentElement.scrollWidth > edge };
}"""


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    monkeypatch.setattr(pages, "SILENT_AFTER", SLOW)


class Actions(NoActions):
    recording = "Recording to recordings/20260102T030405-1."


def node(name, message="running", rate=1000.0, heard=None, **values):
    given = {"ticks": "5000", "rate [Hz]": f"{rate:.1f}", "set rate [Hz]": "1000.0", "period p99 [us]": "1012.3", **values}
    return NodeState(name, message != "running", message, given, time.monotonic() + SLOW if heard is None else heard)


def running_loop():
    state = LiveState()
    times = np.arange(0.0, 10.0, 0.01)
    signals = [np.sin(times + index) for index in range(8)]
    names = [
        f"{what}_{axis}[{unit}]"
        for what, unit in (("reference", "um"), ("command", "V"), ("measurement", "um"), ("error", "um"))
        for axis in AXES
    ]
    state.signals.add(("t[s]", *names), np.column_stack([times, *signals]))
    state.set_turn(("t[s]", *names[2:6]), np.column_stack([times, *signals[2:6]])[:200])
    state.gap.add(("t[s]", "nrmse[%]", "alarm[]"), np.column_stack([times, 0.1 * times, times > 8.0]))
    errors = {f"{what} error {axis} [um]": "0.01234" for what in ("rms", "peak") for axis in AXES}
    state.set_node(NodeState("live_view", False, "running", errors, time.monotonic() + SLOW))
    state.set_node(node("pi_feedback"))
    state.set_node(node("reference_generator"))
    return state


def status(state):
    """Words of the status, the numbers and the events that a window opened now shows."""
    window = pages._Window(pages.Document(), state, Actions())
    return " ".join(window._status.text.split()), window._numbers.text, " ".join(window._events.text.split())


def test_a_loop_that_keeps_its_rate_runs():
    told, numbers, events = status(running_loop())
    assert "Running." in told and "no fault" in events
    assert "rms error x (um)" in numbers and "0.01234" in numbers and "rate (Hz) of 1000" in numbers


def test_rows_alone_are_no_running_loop():
    state = running_loop()
    state.set_node(node("pi_feedback", "234 of 1000 Hz: 775 ticks missed", 234.0))
    told, numbers, events = status(state)
    assert "Running." not in told and "pi_feedback: 234 of 1000 Hz: 775 ticks missed" in told
    assert ">234<" in numbers and "pi_feedback" in numbers and "234 of 1000 Hz" in events
    state.set_node(node("pi_feedback", "311 of 1000 Hz: 680 ticks missed", 311.0))  # the same fault goes on
    state.set_node(node("pi_feedback"))
    told, _, events = status(state)
    assert "Running." in told and events.count("ticks missed") == 1 and "running again, after" in events


def test_a_fault_between_two_diagnostics_leaves_a_trace():
    state = running_loop()
    state.set_node(node("pi_feedback", faults="2"))
    assert [event.words for event in state.events] == ["2 faults, over within a second"]
    state.set_node(node("pi_feedback", faults="2"))
    state.set_node(node("pi_feedback", faults="0"))  # started anew
    assert len(state.events) == 1


def test_a_node_that_falls_silent_is_a_fault_and_one_that_was_ended_is_not(monkeypatch):
    state, now = running_loop(), time.monotonic()
    for each in state.nodes:
        state.set_node(replace(each, heard=now))
    monkeypatch.setattr(time, "monotonic", lambda: now + LOST_AFTER + 1.0)
    state.set_node(node("pi_feedback"))
    state.forget_node("live_view")
    state.look()
    state.look()
    assert [(event.node, event.words, event.fault) for event in state.events] == [("reference_generator", "silent", True)]
    assert [each.fault for each in state.nodes] == ["", "silent"]


@contextmanager
def served(state):
    """Address of the page, served on a thread of its own."""
    from tornado.ioloop import IOLoop

    from hyst_control.dashboard.server import LiveServer

    begun, servers = threading.Event(), []

    def serve():
        IOLoop()
        servers.append(LiveServer(pages.LivePage(state, Actions(), "hyst dashboard: loop, 1000 Hz")))
        begun.set()
        servers[0].run()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    assert begun.wait(30)
    try:
        yield servers[0].url
    finally:
        servers[0].end()
        thread.join(10)


@pytest.mark.parametrize("width", [420, 1400])
def test_nothing_overflows(width):
    if reason := browsers.missing():
        pytest.skip(reason)
    state = running_loop()
    state.set_node(node("pi_feedback", "no measurement and no reference for 0.1 s: the command goes to its safe value", 234.0))
    state.answers.append("16:34:05 stop pi_feedback: stopped: call ~/enable or ~/reset to continue")
    with served(state) as url, browsers.chromium() as chromium:
        page = chromium.new_page(viewport={"width": width, "height": 900})
        page.set_default_timeout(browsers.PATIENCE)
        page.goto(url)
        page.wait_for_function("window.Bokeh && Bokeh.documents.length > 0 && Bokeh.documents[0].get_model_by_name('status')")
        page.wait_for_selector("canvas, .bk-Figure")
        seen = page.evaluate(SEEN)
    assert not seen["wide"] and not seen["scrolls"]
    assert "no measurement" in seen["status"] and "no measurement" in seen["events"] and "0.01234" in seen["numbers"]
