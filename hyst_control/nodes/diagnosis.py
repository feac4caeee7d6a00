# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis node: runs the model beside the system, raises an alarm for the gap, and starts the full diagnosis on request."""

from __future__ import annotations

import math
import os
import secrets
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Integers, Mask
from hyst_control.base.errors import InputError
from hyst_control.diagnose.live.live_twin import GapAlarm, LiveTwin, Window
from hyst_control.diagnose.model_error.baseline import error_on
from hyst_control.model_file import load_model
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.message_io import Sender
from hyst_control.nodes.signal_node.parameters import settings_of
from hyst_control.nodes.signal_node.watched_signal import WatchedSignal
from hyst_control.records.actuator_following import APPLIED, FollowingWatch
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.rosbag2_writer import open_bag
from hyst_control.records.stream.signal_message import Encoder, label_for

GAP_LABEL = "t[s],nrmse[%],alarm[]"
DRAIN_INTERVAL = 0.02  # s, between two polls of the subscriptions: their queues hold far more
ROWS_PER_MESSAGE = 1000  # in the bag of a diagnosis
DIAGNOSE = "import os, sys; os.nice(10); from hyst_control.cli import main; sys.exit(main())"
"""Program of the diagnosing process, at a lower priority than the loop."""


class Stretch(NamedTuple):
    """Successive rows kept for a diagnosis: tick of the first row, command (N, A) in V, and measurement (N, A)."""

    tick: int
    command: Array
    measurement: Array


class DiagnosisNode(SignalNode):
    """Node that runs `model` from `command` and compares it with `measurement`; `diagnose.live_twin` has the alarm's statistics.

    It publishes `residual` (measurement minus prediction, by tick), `gap` (per window: NRMSE in % of the range, alarm 0 or 1) and
    diagnostics. It only listens: no other node waits for it. Up to `bridge` ticks without a command count as held, as by a DAC. After
    a longer gap the model settles at the new command, and `settle` seconds are not judged, because the memory of the hysteresis has
    to fill; nor are they after the start. What the model leaves on the baseline records of `baseline` counts as its own imperfection, which
    raises no alarm. Under the timer nothing is compared while the actuator does not follow its command; the model then runs from
    what the plant says on `applied`.

    `~/diagnose` starts `hyst diagnose` on the rows in the buffer, in a process of lower priority than the loop, and answers
    immediately. A call during the diagnosis returns its progress, the first call afterwards its result. A new folder below `output`
    gets the bag, gap.json, augmented.yaml (if there is an effect to add) and the printed report.
    """

    SETTINGS = settings_of("diagnosis")

    def __init__(self, name: str = "diagnosis", **options: Any) -> None:
        super().__init__(name, **options)
        given = self.settings
        if not given.model:
            raise InputError(f"{self.get_name()}: parameter model: give the model file of the simulator")
        self._model_path = Path(os.path.realpath(given.model))
        try:
            model = load_model(self._model_path)
            self.check_fits(given.model, model.axes, model.units)
            self._twin = LiveTwin(model, self.period)
            self._baseline = [Path(os.path.realpath(bag)) for bag in given.baseline if bag]
            stated = np.broadcast_to(np.asarray(model.noise.get("sigma", 0.0), dtype=float), len(self.axes))
            if self._baseline:
                stated = np.maximum(stated, error_on([read_bag(bag, unit=self.unit) for bag in self._baseline], model))
        except InputError as error:
            raise InputError(f"{self.get_name()}: {error}") from None
        self._twin.settle(np.zeros(len(self.axes)))
        self._twin.follow(np.zeros((1, len(self.axes))))  # compiled before the first message
        self.alarm = GapAlarm(
            self.period,
            max(round(given.window / self.period), 8),
            round(given.calibrate / self.period),
            stated,
            given.false_alarm_rate,
            given.consecutive,
        )
        self._residual = self.output("residual", self.unit)
        self._gap = Sender(self, "gap", GAP_LABEL, given.message_objects)
        self._command = WatchedSignal(self, "command", "V", self.reset)
        self._measurement = WatchedSignal(self, "measurement", self.unit, self.reset)
        self._applied = None if self.lockstep else WatchedSignal(self, APPLIED, "V", self.reset, sparse=True)
        self._following = FollowingWatch(self.period, len(self.axes))
        self._job: Job | None = None
        self._rate_reported: tuple[float, int]
        self._forget()
        self.service("diagnose", self._diagnose)
        self.service("cancel", self._cancel)
        self.every(DRAIN_INTERVAL, self._drain)

    def reset(self) -> None:
        for each in filter(None, (self._command, self._measurement, self._applied)):
            each.rows.forget()
        self._forget()

    def changed(self, name: str, value: Any) -> None:
        if name == "false_alarm_rate":
            self.alarm.false_alarm_rate = value

    def trouble(self) -> str:
        if self._newest is not None and self._newest.alarm:
            return f"gap alarm: {self._newest.nrmse:.3g} % of the range"
        quiet = time.monotonic() - self._last_comparison
        return f"no tick with both command and measurement for {quiet:.0f} s" if quiet > max(1.0, self.settings.timeout) else ""

    def status(self) -> dict[str, Any]:
        newest, now = self._newest, time.monotonic()
        entries: dict[str, Any] = {
            "rate [Hz]": f"{(self._compared - self._rate_reported[1]) / max(now - self._rate_reported[0], 1e-9):.1f}"
        }
        self._rate_reported = now, self._compared
        if newest is not None:
            entries |= {
                f"rms [{self.unit}]": f"{newest.rms:.4g}",
                "nrmse [%]": f"{newest.nrmse:.4g}",
                "alarm": newest.alarm,
                "energy over threshold": "calibrating" if math.isnan(newest.excess) else f"{newest.excess:.3g}",
            }
        return {
            **entries,
            "held samples [%]": f"{100.0 * self.held_share():.2f}",
            "rows compared": self._compared,
            "ticks bridged": self._bridged,
            "settled anew": self._settled_anew,
            **({"ticks not followed": self._not_followed} if self._not_followed else {}),
            "diagnosis": self._job.text() if self._job else "none",
        }

    def held_share(self) -> float:
        """Share of the kept measurements that repeat the previous one although the command moved, 0 to 1."""
        if not self._kept:
            return 0.0
        within = np.ones(self._kept_rows - 1, bool)  # not from one stretch to the next
        within[np.cumsum([len(kept.command) for kept in self._kept])[:-1] - 1] = False
        moved = np.diff(np.concatenate([kept.command for kept in self._kept]), axis=0).any(axis=1) & within
        measured = np.diff(np.concatenate([kept.measurement for kept in self._kept]), axis=0).any(axis=1)
        return int(np.count_nonzero(~measured & moved)) / max(int(np.count_nonzero(moved)), 1)

    def close(self) -> None:
        if self._job is not None:
            self._job.end()

    def _forget(self) -> None:
        self.alarm.reset()
        self._due: int | None = None  # tick of the next command
        self._held = np.zeros(len(self.axes))
        self._uncounted = 0
        self._kept: deque[Stretch] = deque()
        self._kept_rows = 0
        self._from_rest = False  # the kept rows begin with the model settled, as a record should
        self._newest: Window | None = None
        self._last_comparison = time.monotonic()
        self._compared = self._bridged = self._settled_anew = self._not_followed = 0
        self._following.forget()
        self._seen: int | None = None  # tick before which command and measurement had come by the last poll
        self._rate_reported = self._last_comparison, 0  # time of the last reported rate, and rows compared until then

    def _drain(self) -> None:
        self._command.drain()
        self._measurement.drain()
        command, measurement = self._command.rows, self._measurement.rows
        if command.end is not None and measurement.end is not None:
            end: int | None = min(command.end, measurement.end)
            if self._applied is not None:
                self._applied.drain()
                end, self._seen = self._seen, end  # by the next poll all has come that the plant says of these ticks
            if end is not None:
                self._take(end)
        if not self.enabled:
            self._due = None

    def _take(self, end: int) -> None:
        """Use the rows before this tick."""
        (ticks, commands), (measured_ticks, measured) = (each.rows.take_before(end) for each in (self._command, self._measurement))
        if not len(ticks):
            return
        not_followed, voltages = self._driven(ticks, commands)
        if not self.enabled:
            return
        breaks = np.flatnonzero((np.diff(ticks) > 1) | (np.diff(not_followed) != 0)) + 1
        for part in np.split(np.arange(len(ticks)), breaks):
            first = int(ticks[part[0]])
            begin, stop = np.searchsorted(measured_ticks, (first, first + len(part)))
            if not_followed[part[0]]:
                self._not_followed += len(part)
                self.alarm.interrupt()
                stop = begin  # the model has the actuator's voltages, and nothing is compared
            self._follow(first, voltages[part], measured_ticks[begin:stop], measured[begin:stop])

    def _driven(self, ticks: Integers, commands: Array) -> tuple[Mask, Array]:
        """Mask (N,) of the ticks at which the actuator does not follow its command (N, A), and its voltages (N, A), V, at all of them."""
        if self._applied is None:
            return np.zeros(len(ticks), bool), commands
        return self._following.look((ticks, commands), self._applied.rows.take_before(int(ticks[-1]) + 1))

    def _follow(self, first: int, commands: Array, ticks: Integers, measured: Array) -> None:
        """Run the model over successive commands (N, A) and compare it with the measurements (M, A) of these ticks that exist."""
        missing = None if self._due is None else first - self._due
        if missing is None or missing > self.settings.bridge:
            self._settle(first, commands[0])
        elif missing:
            self._bridged += missing
            self.alarm.interrupt()
            self._twin.follow(np.repeat(self._held[None], missing, axis=0))
        self._due, self._held = first + len(commands), commands[-1]
        predicted, slopes = self._twin.follow(commands)
        for run in np.split(np.arange(len(ticks)), np.flatnonzero(np.diff(ticks) > 1) + 1):
            if len(run):
                begin = int(ticks[run[0]])
                there = slice(begin - first, begin - first + len(run))
                self._compare(begin, commands[there], measured[run], predicted[there], slopes[there])

    def _settle(self, tick: int, command: Array) -> None:
        self._settled_anew += self._due is not None
        self._twin.settle(command)
        self.alarm.interrupt()
        self._uncounted = round(self.settings.settle / self.period)
        self._kept.clear()
        self._kept_rows = 0
        self._from_rest = self.lockstep and tick == 0

    def _compare(self, tick: int, commands: Array, measured: Array, predicted: Array, slopes: Array) -> None:
        """Publish, judge and keep successive rows of command, measurement and prediction."""
        self._last_comparison = time.monotonic()
        self._compared += len(measured)
        residual = measured - predicted
        self._residual.send(tick, residual)
        self._keep(Stretch(tick, commands, measured))
        skipped = min(self._uncounted, len(measured))
        self._uncounted -= skipped
        for window in self.alarm.add(measured[skipped:], residual[skipped:], slopes[skipped:]):
            self._newest = window
            last = tick + skipped + window.end - 1
            self._gap.send(np.array([[last * self.period, window.nrmse, float(window.alarm)]]))
            if window.alarm:
                self.warn("gap", f"the model no longer explains the measurement: {window.nrmse:.3g} % of the range")

    def _keep(self, rows: Stretch) -> None:
        most = round(self.settings.buffer / self.period)
        self._kept.append(rows)
        self._kept_rows += len(rows.command)
        while self._kept_rows - len(self._kept[0].command) >= most:
            self._kept_rows -= len(self._kept.popleft().command)
            self._from_rest = False

    def _diagnose(self) -> str:
        """Start a diagnosis, or report the state of the one that was started."""
        if self._job is not None and (self._job.running or not self._job.reported):
            self._job.reported = not self._job.running
            return self._job.text()
        if not self._kept:
            raise InputError("no data yet: run the loop until command and measurement have been received")
        path = self.settings.output
        output = Path(os.path.realpath(path))
        folder = output / f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{secrets.token_hex(4)}"
        try:
            output.mkdir(parents=True, exist_ok=True)
            folder.mkdir()  # with the permissions that the user's umask leaves
            self._write(folder / "record")
            self._job = Job(folder, self._model_path, self._baseline)
        except OSError as error:
            raise InputError(
                f"{path}: {error.strerror or error}: set the parameter output to a folder that can be written"
            ) from None
        return f"started: {self._kept_rows} rows, {self._kept_rows * self.period:.3g} s: {folder}"

    def _cancel(self) -> str:
        """End a diagnosis that is running; its folder keeps the record."""
        if self._job is None or not self._job.running:
            raise InputError("no diagnosis is running")
        self._job.end()
        self._job.reported = True
        return f"canceled: {self._job.folder}"

    def _write(self, path: Path) -> None:
        """Write the kept rows to a bag."""
        ticks = np.concatenate([rows.tick + np.arange(len(rows.command)) for rows in self._kept])
        values = {name: np.concatenate([getattr(rows, name) for rows in self._kept]) for name in ("command", "measurement")}
        wanted = np.ones(len(ticks), bool)
        # A record that does not start at rest gets a gap after its first row: after a gap the diagnosis ignores the time in which the
        # memory of the hysteresis fills.
        wanted[1:2] = self._from_rest
        ticks = ticks[wanted]
        runs = np.split(np.arange(len(ticks)), np.flatnonzero(np.diff(ticks) > 1) + 1)
        with open_bag(path) as bag:
            for topic, unit in (("command", "V"), ("measurement", self.unit)):
                encoder, rows = Encoder(label_for(self.axes, unit)), np.column_stack([ticks * self.period, values[topic][wanted]])
                for run in runs:
                    for begin in range(run[0], run[-1] + 1, ROWS_PER_MESSAGE):
                        part = rows[begin : min(begin + ROWS_PER_MESSAGE, run[-1] + 1)]
                        bag.write(f"/{topic}", encoder.encode(part), round(part[-1, 0] * 1e9))


class Job:
    """Diagnosis in a process of its own."""

    def __init__(self, folder: Path, model: Path, baseline: Sequence[Path]) -> None:
        self.folder, self.reported = folder, False
        self._begun = time.monotonic()
        path = os.pathsep.join(filter(None, [str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH")]))
        files = {"--json": "gap.json", "--augmented": "augmented.yaml", "--report": "gap.html"}
        results = {"--model": model, **{option: folder / name for option, name in files.items()}}
        arguments = ["diagnose", str(folder / "record"), "--quiet", *(str(word) for pair in results.items() for word in pair)]
        if baseline:
            arguments += ["--baseline", *map(str, baseline)]
        with open(folder / "gap.txt", "wb") as words:
            # A session of its own: a Ctrl-C for the node does not reach it, and all its processes can be ended together.
            self._process = subprocess.Popen(
                [sys.executable, "-c", DIAGNOSE, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, "PYTHONPATH": path},
            )

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    def text(self) -> str:
        """Progress, or the result in one sentence with its folder."""
        if self.running:
            return f"running for {time.monotonic() - self._begun:.0f} s: {self.folder}"
        with suppress(OSError):
            lines = (self.folder / "gap.txt").read_text(encoding="utf-8", errors="replace").split("\n")
            if any(lines):
                failed = self._process.returncode != 0
                sentence = next(line for line in (reversed(lines) if failed else lines) if line)
                return f"{'failed: ' if failed else ''}{sentence} ({self.folder})"
        return f"failed: status {self._process.returncode}, no output ({self.folder})"

    def end(self) -> None:
        """End the process and all that it started."""
        if self.running:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGTERM)
            self._process.wait()


main = executable(DiagnosisNode)

if __name__ == "__main__":
    raise SystemExit(main())
