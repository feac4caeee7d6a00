# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that drive or command an actuator as managed nodes: configure, activate, deactivate, clean up, error (ROS 2 lifecycle).

With `autostart` (the default) such a node configures and activates itself, and lifecycle tools may still take it through its states.
`deactivate` and `~/stop` do the same to the actuator: it goes to its safe value, and the node goes on saying so. A node works while it is
active and was not stopped.
"""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleNodeMixin

from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.parameters import Setting

AUTOSTART = Setting("autostart", True, "", "configure and activate the node at its start; false: wait for lifecycle transitions")

UNCONFIGURED, INACTIVE, ACTIVE = "unconfigured", "inactive", "active"


class ManagedNode(LifecycleNodeMixin, SignalNode):
    """Node with managed states. Subclasses have the parameter `AUTOSTART` and call `begin` last when they are created."""

    def __init__(self, name: str, **options: Any) -> None:
        SignalNode.__init__(self, name, **options)
        LifecycleNodeMixin.__init__(self)
        self._refusal = ""  # reason of a transition that failed
        self._broken = False  # True while the node goes through its error state
        self.active = False  # True in the state active
        self.ever_active = False
        self._guard_transitions()
        if not self.settings.autostart:
            waiting = "waiting for lifecycle transitions, as autostart is false"
            self.once(lambda: self.get_logger().info(f"{self.state}: {waiting}"))

    @property
    def state(self) -> str:
        """Label of the present state."""
        return str(self._state_machine.current_state[1])

    @property
    def working(self) -> bool:
        return self.enabled and self.active

    def configure(self) -> None:
        """Make ready for work, such as by connecting to a device; an exception is the reason of a refusal."""

    def activate(self) -> None:
        """Begin to work."""

    def clean_up(self) -> None:
        """Undo `configure`; the actuator is at its safe value, or the device has failed."""

    def begin(self) -> None:
        """Configure and activate the node, unless `autostart` is false."""
        if self.settings.autostart:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    raise InputError(f"{self.get_name()}: {self._refusal}")

    def fail(self, reason: str) -> None:
        """Go through the error state to the unconfigured one, because the node cannot work; `~/reset` or `configure` tries again."""
        self.get_logger().error(f"{reason}: call ~/reset, or configure and activate, to try again")
        self._refusal, self._broken = reason, True
        try:
            if self.state == ACTIVE:
                self.trigger_deactivate()
            elif self.state == INACTIVE:
                self.trigger_cleanup()
        finally:
            self._broken = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Carry out the transition from this `state`, with FAILURE and a line in the log when `configure` raises."""
        try:
            self.configure()
        except Exception as error:  # a driver may raise anything
            self._refusal = str(error).removeprefix(f"{self.get_name()}: ") or type(error).__name__
            self.get_logger().error(f"cannot be configured: {self._refusal}")
            return TransitionCallbackReturn.FAILURE
        self._refusal = ""
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.active = self.ever_active = True
        self.activate()
        self.schedule.resume()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Carry out the transition from this `state`: an actuator goes to its safe value from the next tick on."""
        self.active = False
        return TransitionCallbackReturn.ERROR if self._broken else TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._broken:
            return TransitionCallbackReturn.ERROR
        self.clean_up()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Carry out the transition from this `state`: release what the node has, and wait to be configured again."""
        self.active = False
        try:
            self.clean_up()
        except Exception as error:  # a driver that has failed may fail again
            self.get_logger().warning(f"while cleaning up: {error}")
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Carry out the transition from this `state`: the actuator goes to its safe value, then the node ends."""
        self.active = False
        self.wind_down()
        self.every(0.01, self._end)
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Destroy the node with its states, for which the middleware would keep it until somebody collects the garbage."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def _reset(self) -> str:
        if self.state == UNCONFIGURED and self.settings.autostart:
            self.begin()
        return super()._reset()

    def _end(self) -> None:
        if self.wound_down and not self.finished.done():
            self.finished.set_result(0)

    def _guard_transitions(self) -> None:
        """Refuse transitions that the present state does not have: rclpy's own service would end the process."""
        service = self._service_change_state
        change = service.callback

        def checked(request: Any, response: Any) -> Any:
            wanted = request.transition
            known = [(number, label) for number, label, *_ in self._state_machine.available_transitions]
            if wanted.label and any(label == wanted.label for _, label in known) or any(wanted.id == number for number, _ in known):
                return change(request, response)
            self.get_logger().warning(f"transition {wanted.label or wanted.id} does not exist in the state {self.state}: refused")
            response.success = False
            return response

        service.callback = checked
