# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst dashboard` beside a real loop, in a real browser: curves move, buttons act on the nodes, and nobody gets in without the token."""

from __future__ import annotations

import base64
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import browser as browsers
import pytest
from loop_case import MODEL, RUNNING

from hyst_control.base.errors import InputError
from hyst_control.dashboard.live_state import LiveState
from hyst_control.nodes.dashboard import LoopActions, LoopSettings, live_loop
from hyst_control.processes.node_processes import Processes
from hyst_control.records.bags.bag_reader import read_bag

RATE = 200.0
HYST = """import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts a job in the background
from hyst_control.cli import main
raise SystemExit(main(sys.argv[1:]))
"""
SEEN = """() => {
  const page = Bokeh.documents[0], named = name => page.get_model_by_name(name);
  const words = name => named(name).text.replace(/<style>[^]*?<\\/style>|<[^>]*>/g, " ").replace(/\\s+/g, " ").trim();
  const drawn = name => named(name) ? named(name).renderers[0].data_source : null;
  const error = drawn("error"), loop = drawn("loop"), gap = drawn("gap");
  return { status: words("status"), answers: words("answers"), nodes: words("nodes"), record: named("record").label,
    events: words("events"), numbers: words("numbers"),
    time: error ? error.data.t[error.data.t.length - 1] : -1,
    columns: error ? Object.keys(error.data) : [],
    command: error ? error.data["command_x[V]"][error.data.t.length - 1] : NaN,
    loop: loop ? loop.data["command_x[V]"].length : 0, gap: gap ? gap.data.t.length : 0 };
}"""


PATIENT = {"overrun_ticks": 0, "frozen_time": 0.0}
"""So that a busy machine is no fault of the loop, which would bring the command to 0 as well as the button does."""


def loop(folder):
    """A slow loop on the wall clock with its live twin and its live view."""
    each = {
        "reference_generator": {
            "signal": "sine",
            "frequency": 2.0,
            "amplitude": 2.0,
            "offset": 3.0,
            "duration": 1.0,
            "repeat": True,
        },
        "hampi_feedforward": {"kind": "proportional", "gain": [8.0]},
        "pi_feedback": {"kp": 0.2, "ki": 20.0, "upper": 150.0, "slew_limit": 2e4, "safe_rate": 500.0, **PATIENT},
        "plant": {"model": MODEL},
        "diagnosis": {"model": MODEL, "output": str(folder / "diagnosis"), "window": 0.1, "calibrate": 0.5, "buffer": 1.0},
        "live_view": {},
    }
    common = {"schedule": "timer", "rate_hz": RATE, "timeout": 5.0, "axes": ["x"], "unit": "um"}
    return {name: {**common, **own} for name, own in each.items()}


@contextmanager
def dashboard(folder, *arguments):
    """The command in a process of its own, as a shell's job in the background; its address."""
    process = subprocess.Popen(
        [sys.executable, "-c", HYST, "dashboard", "--rate", str(RATE), "--folder", str(folder / "recordings"), *arguments],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        # A middleware of which others were killed on this machine reports their shared memory on the same output.
        yield next(line.strip() for line in process.stdout if line.startswith("http")), process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        finally:
            process.stdout.close()


def recorded_commands(folder):
    """Rows of the command in the recording so far."""
    bags = [path for path in (folder / "recordings").iterdir() if any(path.glob("*.mcap"))]
    try:
        return len(read_bag(bags[0]).signals["command"].time) if bags else 0
    except (InputError, KeyError):
        return 0  # nothing has been written yet


def until(look, condition, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition(seen := look()):
        assert time.monotonic() < end, seen
        time.sleep(0.2)
    return seen


@pytest.fixture
def running(tmp_path, domain):
    with Processes(tmp_path / "log", domain) as processes:
        processes.compose(loop(tmp_path))
        yield processes


def test_a_browser_shows_the_loop_and_its_buttons_act(running, tmp_path):
    if reason := browsers.missing():
        pytest.skip(reason)
    with dashboard(tmp_path) as (url, process), browsers.chromium() as chromium:
        page, complaints, elsewhere = chromium.new_page(viewport={"width": 1000, "height": 900}), [], []
        page.set_default_timeout(browsers.PATIENCE)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda line: complaints.append(line.text) if line.type in ("error", "warning") else None)
        page.on("request", lambda request: elsewhere.append(request.url) if not request.url.startswith(url) else None)
        assert page.goto(url).status == 200
        page.wait_for_function("window.Bokeh && Bokeh.documents.length > 0 && Bokeh.documents[0].get_model_by_name('status')")

        def look():
            return page.evaluate(SEEN)

        def press(name):
            page.get_by_role("button", name=name, exact=True).click()

        first = until(look, lambda seen: seen["time"] > 0 and seen["loop"] > 10 and seen["gap"] > 0)
        assert {"t", "reference_x[um]", "command_x[V]", "measurement_x[um]", "error_x[um]"} <= set(first["columns"])
        until(look, lambda seen: seen["time"] > first["time"] + 0.5)  # curves move
        until(look, lambda seen: seen["status"] == "Running." or "ticks missed" in seen["status"])
        until(
            look,
            lambda seen: all(re.search(rf"\b{name} {RUNNING}", seen["nodes"]) for name in ("pi_feedback", "plant", "diagnosis")),
        )
        press("record")
        until(look, lambda seen: "Recording to" in seen["status"] and seen["record"] == "end recording")
        until(lambda: recorded_commands(tmp_path), lambda rows: rows > 0)  # a bag is readable while it is written
        until(look, lambda seen: seen["command"] > 5.0)
        press("stop")
        until(look, lambda seen: all(f"stop {name}: stopped" in seen["answers"] for name in ("pi_feedback", "plant")))
        until(look, lambda seen: seen["command"] == 0.0 and "pi_feedback: stopped" in seen["status"])
        assert "pi_feedback: stopped" in look()["events"] and re.search(r"rms error x \(um\) [0-9.]+ peak", look()["numbers"])
        press("enable")
        until(look, lambda seen: seen["command"] > 5.0 and "enable pi_feedback: enabled" in seen["answers"])
        press("reset")
        until(look, lambda seen: "reset pi_feedback: reset" in seen["answers"])
        press("end recording")
        until(look, lambda seen: "recorded: " in seen["answers"] and seen["record"] == "record")
        running.check()
        assert not complaints and not elsewhere
    assert process.returncode == 0
    [bag] = (tmp_path / "recordings").iterdir()
    command = read_bag(bag).signals["command"].values
    assert command.max() > 5.0 and command.min() == 0.0  # the stop is in the recording


def test_requests_reach_the_loop_without_a_page(running, tmp_path, ros_context):
    """Stop, enable and reset reach the nodes that drive, and a recording begins and ends, all within this process."""
    state, folder = LiveState(), tmp_path / "recordings"

    def answers():
        return " ".join(state.answers)

    with live_loop(LoopSettings(rate_hz=RATE), state, folder, ros_context) as actions:
        until(lambda: {node.name for node in state.nodes}, lambda names: {"pi_feedback", "plant", "diagnosis"} <= names)
        until(lambda: (len(state.signals.columns), state.gap.epoch, len(state.turn[0])), all)
        actions.record()
        until(lambda: recorded_commands(tmp_path), lambda rows: rows > 0)
        assert actions.recording.startswith("Recording to ")
        for what, words in (("stop", "stopped"), ("enable", "enabled"), ("reset", "reset")):
            actions.ask(what)
            until(answers, lambda text, each=f"{what} pi_feedback: {words}": each in text)
        actions.record()
        until(lambda: actions.recording, lambda words: not words)
        assert "recorded: " in answers()
        folder.joinpath("file").touch()
        LoopActions(actions._node, actions._processes, LoopSettings(), folder / "file").record()
        assert "start with --folder and one that can be written" in answers()
    running.check()


def test_a_request_without_a_loop_says_that_nobody_was_asked(tmp_path, ros_context):
    state = LiveState()
    with live_loop(LoopSettings(), state, tmp_path, ros_context) as actions:
        actions.ask("stop")
        until(lambda: list(state.answers), lambda answers: answers == ["stop: nobody was asked, because no node publishes command"])
    assert LoopSettings(namespace="/rig/").arguments[1:4] == ["--ros-args", "-r", "__ns:=/rig"]


def answer(url, path, headers=()):
    """Status of a request."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=20)
    try:
        connection.request("GET", path, headers=dict(headers))
        return connection.getresponse().status
    finally:
        connection.close()


def upgrade(origin):
    """Headers of a browser that asks for a websocket from a page of this origin."""
    key = base64.b64encode(os.urandom(16)).decode()
    protocols = "bokeh, nothing"
    given = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Key": key, "Sec-WebSocket-Version": "13"}
    return {**given, "Sec-WebSocket-Protocol": protocols, "Origin": origin}.items()


def test_nobody_gets_in_without_the_token(domain, tmp_path):
    address = tmp_path / "address.json"
    address.write_text("of an earlier page")  # readable by all
    with dashboard(tmp_path, "--json", str(address)) as (url, _):
        assert json.loads(address.read_text())["url"] == url and address.stat().st_mode & 0o777 == 0o600
        parts = urlsplit(url)
        token = parts.path.strip("/")
        assert parts.hostname == "127.0.0.1" and len(token) >= 40
        assert answer(url, f"/{token}/") == 200
        own, foreign = f"http://{parts.netloc}", "http://elsewhere.example"
        for path in ("/", "/wrong/", f"/{token[:-1]}/", f"/x{token}/", "/ws", "/wrong/ws", "/static/js/bokeh.min.js", "/metadata"):
            assert answer(url, path) == 403, path
            assert answer(url, path, upgrade(own)) == 403, path
        for host in ("elsewhere.example", f"elsewhere.example:{parts.port}", "127.0.0.1", f"127.0.0.1.x.example:{parts.port}"):
            for path in ("", "ws", "static/js/bokeh.min.js"):  # by a name that was made to resolve to here
                assert answer(url, f"/{token}/{path}", {"Host": host}.items()) == 403, (host, path)
        assert answer(url, f"/{token}/ws", upgrade(foreign)) == 403
        assert answer(url, f"/{token}/ws", upgrade(f"http://127.0.0.1:{parts.port + 1}")) == 403
        assert answer(url, f"/{token}/ws", upgrade(own)) == 101  # and its session, which this server did not begin, is refused
        rows = [line.split() for table in ("tcp", "tcp6") for line in Path("/proc/net", table).read_text().splitlines()]
        listening = {row[1] for row in rows if row[3] == "0A"}
        assert [each for each in listening if each.endswith(f":{parts.port:04X}")] == [f"0100007F:{parts.port:04X}"]
    with dashboard(tmp_path) as (again, _):
        assert urlsplit(again).path != parts.path


def test_a_foreign_session_is_closed(domain, tmp_path):
    """A websocket whose session this server did not begin gets nothing but its end."""
    with dashboard(tmp_path) as (url, _):
        parts = urlsplit(url)
        with socket.create_connection((parts.hostname, parts.port), timeout=20) as line:
            lines = [f"GET {parts.path}ws HTTP/1.1", f"Host: {parts.netloc}"]
            lines += [f"{name}: {value}" for name, value in upgrade(f"http://{parts.netloc}")]
            line.sendall("\r\n".join([*lines, "", ""]).encode())
            said = b""
            while part := line.recv(4096):
                said += part
        head, _, frames = said.partition(b"\r\n\r\n")
        assert b" 101 " in head.splitlines()[0] and (not frames or frames[0] & 0x0F == 8)  # a closing frame at most


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rate", "-3"], "rate_hz"),
        (["--port", "70000"], "--port: must be 0 to 65535, got 70000"),
        (["--namespace", "ä b"], "hyst dashboard: --namespace: Invalid namespace: namespace must not contain"),
        (["--window", "0"], "--window: must be > 0 and ≤ 3600, got 0.0"),
    ],
)
def test_bad_settings_are_one_line(domain, arguments, words):
    ended = subprocess.run([sys.executable, "-c", HYST, "dashboard", *arguments], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and words in ended.stderr and len(ended.stderr.strip().splitlines()) == 1


def test_a_port_in_use_is_one_line(domain):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        command = [sys.executable, "-c", HYST, "dashboard", "--port", port]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and f"--port: {port}: Address already in use" in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1
