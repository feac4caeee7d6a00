# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Plant node: runs a reference simulation or a model file, and is the clock of the loop in lockstep."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.timer import Timer
from std_msgs.msg import Int64

from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import parse_yaml
from hyst_control.control.feedback.loop import Plant
from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes.execution.run import main as run_main
from hyst_control.nodes.loop.actuator import SAFE_SETTINGS, Actuator
from hyst_control.nodes.signal_node.loop_latency import LoopLatency
from hyst_control.nodes.signal_node.managed import AUTOSTART, ManagedNode
from hyst_control.nodes.signal_node.message_io import QUEUE
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.nodes.signal_node.signal_ports import Input
from hyst_control.nodes.signal_node.timer import LONGEST_GAP
from hyst_control.records.stream.row_repetition import Standstill
from hyst_control.records.stream.signal_rows import Wait

CONFIRMATION = 0.1
"""Share of `retry` for which the executor must have served events, without progress, before a standstill is believed."""
REPETITIONS_BEFORE_JOINING = 5
"""Successive repetitions without an answer after which a plant restarted during a run continues at the tick of that run."""


class PlantNode(ManagedNode):
    """Node that receives `command` (V) and publishes `measurement`.

    In lockstep it publishes measurement[0] first, then for command rows k0 … k1 the measurement rows k0 + 1 … k1 + 1. As long as no
    command arrives, it repeats the newest measurement every `retry` s, which starts the loop and makes up for a lost message or a
    restarted node. With `ticks` it ends after that many command rows and has published as many measurement rows.
    Under the timer, each tick runs the plant over the commands since the previous tick; the newest command is held for `timeout` at
    most. Then, and while two sources contradict each other, a watchdog brings the actuator to `safe_command` at `safe_rate`
    (`control.command_watchdog`), at which it also approaches the first command and one that comes back. While it does not follow the
    command, and in lockstep while none arrives, it publishes on `applied` what is on the actuator (V).
    """

    REMEDIES = {"recorded": "is a recorder running? wait_for_recorder is true"}
    SETTINGS = (
        Setting("plant", "", "", "reference simulation: a name in config/plants or a file"),
        Setting("model", "", "", "model file, run instead of a reference simulation"),
        Setting(
            "parameters",
            "",
            "",
            "parameters of the reference simulation that replace those of its file, as YAML: '{mode_frequency: 1180.0}'",
        ),
        Setting(
            "effects", "", "", "effects in the reference simulation, as YAML: '[{name: delay, tau: 4.0e-4, axis: x, from: 0.5}]'"
        ),
        Setting("seed", 0, "1", "seed of the plant's noise", 0, 2**31 - 1),
        Setting("ticks", 0, "ticks", "length of the run, 0 for endless", 0, 2**52),
        Setting(
            "start",
            "rest",
            "",
            "initial state: settled at 0 V (rest) or at the first command (open loop)",
            choices=("rest", "first_command"),
        ),
        Setting("retry", 0.2, "s", "time without a command after which the newest measurement is repeated", 1e-3, 60.0),
        *SAFE_SETTINGS,
        AUTOSTART,
        Setting("most_ahead", 512, "ticks", "most ticks that the plant may be ahead of a recorder it waits for", 128, 1_000_000),
        Setting("wait_for_recorder", False, "", "stay close to the rows that the recorder has stored, in lockstep"),
    )

    def __init__(self, name: str = "plant", plant: Plant | None = None, **options: Any) -> None:
        """Create the node."""
        super().__init__(name, **options)
        self.ends = self.settings.ticks > 0
        self._plant = plant or self._described()
        rest = np.zeros(len(self.axes))
        self._plant.reset(rest)  # compiled before the first tick
        self._plant.step(rest[None])
        self._tick: int | None = None  # of the newest measurement
        self._held = rest  # newest command, in lockstep
        self._stalled_offer: int | None = None  # first tick of the commands offered at a standstill that others precede
        self._recorded = -1
        self._recorded_at = time.monotonic()  # s: time of the recorder's last progress
        self._standstill = Standstill()
        self._stood_at: tuple[int | None, int | None] | None = None  # progress at the last look, while it is to be confirmed
        self._confirmation: Timer | None = None
        self._looked = -math.inf  # s
        self._latency = LoopLatency()
        self.measurement = self.output("measurement", self.unit)
        self._actuator = Actuator(self)
        self.command, self.applied = self._actuator.command, self._actuator.output
        if self.settings.wait_for_recorder and self.lockstep:
            self.create_subscription(Int64, "recorded", self._on_recorded, QUEUE)
        self.begin()
        if self.lockstep:
            self._confirmation = self.every(CONFIRMATION * self.settings.retry, self._confirm)
            self._confirmation.cancel()
            self.every(self.settings.retry, self._retry)
        self.schedule.start(0.1)

    def activate(self) -> None:
        if self._tick is None:
            self.reset()
            if self.lockstep:
                self.once(self.measurement.repeat)  # a node of this process may be made after the plant

    def advance(self) -> None:
        if not self.working:
            return
        rows, length = self.command.rows, self.settings.ticks
        while rows.available:
            tick = self._settle(self._newest_command()) if self._tick is None else self._tick
            allowed = rows.available if not length else min(rows.available, length - tick)
            if self.settings.wait_for_recorder:
                allowed = min(allowed, self._recorded + self.settings.most_ahead - tick if self._recorded >= 0 else 0)
            if allowed <= 0:
                return
            commands = rows.take(allowed)
            self._held = commands[-1]
            measurements = self._plant.step(commands)
            first = tick + 1
            self._tick = tick + allowed
            if length and self._tick == length:
                if allowed > 1:
                    self.measurement.send(first, measurements[:-1])
                self._end()
                return
            self.measurement.send(first, measurements)

    def tick(self, tick: int) -> None:
        if self._tick is None:
            self._tick = tick
            self.measurement.send(tick, self._plant.reset(self._actuator.watchdog.applied)[None])
            return
        first = max(self._tick, tick - max(self.settings.block, round(LONGEST_GAP / self.period)))
        commands = np.empty((tick - first, len(self.axes)))
        for row in range(len(commands)):
            commands[row] = self._actuator.voltage(first + row, self.working)
        self._actuator.report(tick)
        measurements = self._plant.step(commands)
        self._latency.sent(tick)
        self.measurement.send(first + 1, measurements)  # those of missed ticks too: the sensor was there
        self._tick = tick
        if self.settings.ticks and self.counts["ticks"] * self.settings.block >= self.settings.ticks:
            self.finish(self.measurement.publisher)

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        self._latency.answered(tick, stamp)

    def reset(self) -> None:
        self._tick = None
        self._actuator.reset()
        self.measurement.clear()
        if self.lockstep:
            self.command.rows.expect(0)
            if self.settings.start == "rest":
                self._settle(np.zeros(len(self.axes)))

    def out_of_order(self, source: Input, tick: int) -> None:
        if self._standstill.looks >= REPETITIONS_BEFORE_JOINING and self._tick in (
            None,
            0,
        ):  # no node has tick 0 any more: restarted during a run
            if tick != self._stalled_offer:  # a single message may come from anybody; the loop repeats its own
                self._stalled_offer = tick
                return
            self.get_logger().warning(f"joining a run in progress at tick {tick}")
            self._tick = None if self.settings.start == "first_command" else tick
            source.rows.expect(tick)

    def trouble(self) -> str:
        return "" if self.lockstep else self._actuator.trouble()

    def waits(self, now: float) -> list[Wait]:
        """Signals that the node is waiting for: the command, or the recorder while commands or the end of the run depend on it."""
        over = self.settings.ticks > 0 and self._tick == self.settings.ticks and not self.finished.done()
        if self.lockstep and self.settings.wait_for_recorder and (over or self.command.rows.available):
            return [Wait("recorded", self._recorded + 1, now - self._recorded_at)]
        return super().waits(now)

    def status(self) -> dict[str, Any]:
        return {"tick": self._tick, "recorded": self._recorded, **self._latency.entries()}

    def _settle(self, command: Array) -> int:
        """Settle the plant at a command (A,), publish the measurement, and return its tick."""
        first, tick = self._plant.reset(command), self.command.rows.start
        self._tick = tick
        self.measurement.send(tick, first[None])
        return tick

    def _newest_command(self) -> Array:
        row = self.command.rows.newest(self.command.rows.start)
        assert row is not None
        return row

    def _on_recorded(self, message: Int64) -> None:
        if message.data > self._recorded:
            self._recorded, self._recorded_at = message.data, time.monotonic()
        if self.settings.ticks and self._tick == self.settings.ticks:
            self._end()
        else:
            self.advance()

    def _end(self) -> None:
        if not self.settings.wait_for_recorder or self._recorded >= self.settings.ticks - 1:
            self.finish(self.measurement.publisher)

    @property
    def _progress(self) -> tuple[int | None, int | None]:
        """Ends of the commands and of the measurements, which stay as they are when the run stands still."""
        return self.command.rows.end, self._tick

    def _retry(self) -> None:
        """Look whether the run stands still; if so, look again once everything that has arrived was served, and repeat.

        On a busy machine the process itself may have stood still: then nothing is lost, and what is repeated would only cost more.
        """
        now = time.monotonic()
        if now - self._looked < 0.5 * self.settings.retry:  # a timer that was late makes up for it by several calls
            return
        self._looked = now
        if self._standstill.look(self._progress) and self._confirmation is not None:
            self._stood_at = self._progress
            self._confirmation.reset()

    def _confirm(self) -> None:
        """Repeat what was sent, unless the run has gone on since the last look."""
        assert self._confirmation is not None
        self._confirmation.cancel()
        if self.finished.done() or not self.working or self._stood_at != self._progress:
            return
        looks = self._standstill.looks
        if self._tick:
            self.applied.send(self._tick - 1, self._held[None])
        if looks == 1:
            self.measurement.repeat_newest()
        elif looks:
            self.measurement.repeat()  # a node lacks earlier rows, its own or those that followed from them

    def _described(self) -> Plant:
        given, name = self.settings, self.get_name()
        if bool(given.plant) == bool(given.model):
            raise InputError(f"{name}: give either the parameter plant or the parameter model")
        try:
            if given.model:
                if given.parameters or given.effects:
                    raise InputError(
                        "parameters and effects belong to a reference simulation: write them into the model file instead"
                    )
                plant: Any = Simulator(load_model(given.model), self.period)
            else:
                from hyst_plant_sim.physics import load_plant

                path = given.plant if Path(given.plant).exists() else config_path(f"plants/{given.plant}.yaml")
                plant = load_plant(
                    path,
                    seed=given.seed,
                    sample_time=self.period,
                    effects=_yaml(given.effects, "effects", list),
                    parameters=_yaml(given.parameters, "parameters", dict),
                )
        except ValueError as error:
            raise InputError(f"{name}: {error}") from None
        self.check_fits(f"{name}: {given.plant or given.model}", plant.axes, plant.units)
        found: Plant = plant
        return found


def _yaml(text: str, name: str, kind: type) -> Any:
    """Parse a parameter's text; None when it is empty. Raises `InputError` when it is not of the kind."""
    if not text.strip():
        return None
    try:
        found = parse_yaml(text, name)
    except InputError:
        found = None
    if not isinstance(found, kind):
        raise InputError(
            f"{name}: must be {'a list [{name: …}, …]' if kind is list else 'a mapping {name: value, …}'}, got {text!r}"
        )
    return found


def main() -> int:
    """Run the executable; its exit status."""
    return run_main(PlantNode)


if __name__ == "__main__":
    raise SystemExit(main())
