# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The feedback node through lifecycle, faulty messages and faulty clocks in any order, with the watchdog of an actuator behind it."""

from __future__ import annotations

import math
import sys
import time
from types import SimpleNamespace

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.control.feedback.command_watchdog import CommandWatchdog
from hyst_control.nodes.pi_feedback import PiFeedback

PERIOD, LOWER, UPPER, SLEW, RATE, SAFE = 0.01, 0.0, 50.0, 500.0, 400.0, 2.0
LABELS = {"feedforward": "t[s],x[V]", "reference": "t[s],x[um]", "measurement": "t[s],x[um]"}
ALL_SAFE = math.ceil((UPPER - LOWER) / (RATE * PERIOD)) + 2
"""Ticks after which a stopped command is at its safe value."""
ODD = st.one_of(st.floats(), st.floats(-5.0, 60.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e308, 5e-324]))


class Faults(RuleBasedStateMachine):
    """One clock for the node, and one for whoever sends; both are turned by hand."""

    context = None

    @initialize(feedback=st.booleans(), integral=st.sampled_from([0.0, 100.0]), recovery=st.sampled_from(["automatic", "manual"]))
    def begin(self, feedback, integral, recovery):
        self.now, self.skew, self.stalled, self.loses = 1000.0 + 0.5 * PERIOD, 0, False, False
        clock = SimpleNamespace(monotonic=lambda: self.now, sleep=lambda _: None, time=time.time, time_ns=time.time_ns)
        self.turned = [module for name, module in sys.modules.items() if name.startswith("hyst_control.nodes")]
        self.turned = [module for module in self.turned if getattr(module, "time", None) is time]
        for module in self.turned:
            module.time = clock
        given = dict(schedule="timer", rate_hz=1 / PERIOD, lower=LOWER, upper=UPPER, slew_limit=SLEW, safe_rate=RATE, timeout=0.2)
        given |= dict(safe_command=[SAFE], feedback=feedback, kp=0.5 if feedback else 0.0, ki=integral if feedback else 0.0)
        given |= dict(measurement_lower=-1.0, measurement_upper=20.0, frozen_time=0.05, recovery=recovery, takeover_time=0.05)
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node = PiFeedback(context=self.context, parameter_overrides=overrides)
        self.node.timer.call_instead(None)
        self.commands, self.applied = [0.0], [0.0]
        self.watchdog, self.limits = CommandWatchdog(np.zeros(1), np.full(1, SAFE), RATE, PERIOD), CommandLimits(LOWER, UPPER)
        self.node.command.sender.send = lambda block: self.commands.extend(block[:, 1].tolist())
        self.runs(20, 3.0)

    def teardown(self):
        for module in getattr(self, "turned", ()):
            module.time = time
        if hasattr(self, "node"):
            self.node.destroy_node()

    def turn(self, ticks=1):
        """Let time pass, tick by tick; what was sent last is on the actuator, unless it was lost."""
        for _ in range(ticks):
            self.now += PERIOD
            before = len(self.commands)
            self.node.timer.call(self.now)
            fresh = len(self.commands) > before and not self.loses
            command = np.array(self.commands[-1:]) if fresh else None
            command = self.limits.limited(command, self.watchdog.applied) if fresh else None
            self.applied.append(float(self.watchdog.apply(command, trusted=fresh)[0]))

    def send(self, values, shift=0):
        stamp = (math.floor(self.now / PERIOD) + self.skew + shift) * PERIOD
        for signal in self.node.inputs:
            signal.receive(LABELS[signal.topic], np.array([[stamp, values[signal.topic]]]), int(self.now * 1e9))

    @rule(ticks=st.integers(1, 20), wanted=st.floats(0.5, 5.0))
    def runs(self, ticks, wanted):
        for _ in range(ticks):
            self.send({"feedforward": 8.0 * wanted, "reference": wanted, "measurement": self.commands[-1] / 8.0})
            self.turn()

    @rule(feedforward=ODD, reference=ODD, measurement=ODD, shift=st.integers(-300, 300))
    def odd_rows(self, feedforward, reference, measurement, shift):
        with np.errstate(all="ignore"):
            self.send({"feedforward": feedforward, "reference": reference, "measurement": measurement}, shift)
            self.turn()

    @rule(label=st.text(max_size=8), stamp=ODD, rows=st.integers(0, 3))
    def unreadable_rows(self, label, stamp, rows):
        for signal in self.node.inputs:
            signal.receive(label, np.full((rows, 2), stamp), 0)
            signal.receive(LABELS[signal.topic], np.full((rows, 2), stamp), 0)
        self.turn()

    @rule(ticks=st.integers(1, 60))
    def silence(self, ticks):
        self.turn(ticks)

    @rule(seconds=st.one_of(st.floats(-900.0, 900.0), st.floats(-0.05, 0.05)))
    def clock_jumps(self, seconds):
        self.now = max(self.now + seconds, 1.0)
        self.turn()

    @rule(calls=st.integers(1, 5))
    def clock_is_frozen(self, calls):
        for _ in range(calls):
            self.node.timer.call(self.now)

    @rule(ticks=st.integers(-200, 200))
    def senders_clock_is_off(self, ticks):
        self.skew = ticks

    @rule(loses=st.booleans())
    def commands_are_lost(self, loses):
        self.loses = loses

    @rule()
    def activated(self):
        for state, change in (("unconfigured", self.node.trigger_configure), ("inactive", self.node.trigger_activate)):
            if self.node.state == state:
                assert change() == TransitionCallbackReturn.SUCCESS

    @rule()
    def reset(self):
        self.node._reset()

    @rule(reason=st.sampled_from(["the driver failed", ""]))
    def fails(self, reason):
        self.node.fail(reason)

    @rule(how=st.sampled_from(["deactivate", "clean up", "stop"]))
    def stopped_it_goes_to_its_safe_value(self, how):
        if how == "stop":
            self.node._stop()
        elif self.node.state == "active":
            self.node.trigger_deactivate()
            if how == "clean up":
                self.node.trigger_cleanup()
        before = len(self.commands)
        self.turn(ALL_SAFE + 100)  # it listens for what is applied before it begins
        if self.node.state != "unconfigured" and len(self.commands) > before:
            assert self.commands[-1] == SAFE

    @rule()
    def a_dead_feedback_leaves_the_actuator_safe(self):
        if self.watchdog.armed:
            self.loses = True
            self.turn(ALL_SAFE)
            self.loses = False
            assert self.applied[-1] == SAFE

    @invariant()
    def commands_are_finite_within_limits_and_smooth(self):
        if not hasattr(self, "commands"):
            return
        for values, step in ((self.commands, SLEW * PERIOD), (self.applied, SLEW * PERIOD)):
            rows = np.array(values)
            assert np.isfinite(rows).all() and rows.min() >= LOWER and rows.max() <= UPPER
            assert len(rows) < 2 or np.abs(np.diff(rows)).max() <= step * (1 + 1e-9)
            del values[:-1]


def test_no_order_of_faults_lets_the_command_leave_its_limits(ros_context):
    Faults.context = ros_context
    checks = settings(
        max_examples=25, stateful_step_count=25, deadline=None, phases=(Phase.generate,), suppress_health_check=list(HealthCheck)
    )
    run_state_machine_as_test(Faults, settings=checks)
