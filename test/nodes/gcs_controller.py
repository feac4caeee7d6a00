# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A small controller that speaks the General Command Set over TCP: two axes of 0.1 um/V, the servo, and an error memory."""

from __future__ import annotations

import socketserver
import threading
import time

GAIN = 0.1  # um/V
RANGE = (-30.0, 130.0)  # V
OUT_OF_LIMITS, SERVO_IS_ON, UNKNOWN = 7, 34, 2


class GcsController:
    """Server on a free port of this machine; a context manager."""

    def __init__(self) -> None:
        self.voltage = {"1": 12.0, "2": 0.0}
        self.servo = {"1": True, "2": True}
        self.error = 0
        self.lost: list[str] = []
        self._counting = threading.Lock()
        self.silent = False  # takes commands and answers nothing
        self.late = 0.0  # s, by which the next answer comes late
        self.connections = 0  # open now
        controller = self

        class Handler(socketserver.StreamRequestHandler):
            def setup(self) -> None:
                super().setup()
                with controller._counting:
                    controller.connections += 1

            def handle(self) -> None:
                for line in self.rfile:
                    answer = controller.answer(line.decode().split())
                    if answer and controller.late:
                        time.sleep(controller.late)
                        controller.late = 0.0
                    if answer and not controller.silent:
                        self.wfile.write(answer.encode())

            def finish(self) -> None:
                super().finish()
                with controller._counting:
                    controller.connections -= 1

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = daemon_threads = True

        self._server = Server(("127.0.0.1", 0), Handler)
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def answer(self, words: list[str]) -> str:
        """Answer of a line; "" for commands that have none."""
        command, *rest = words or [""]
        axes = rest or list(self.voltage)
        if command == "*IDN?":
            return "(c) simulated, E-000, 1, 1.0\n"
        if command == "CSV?":
            return "2.0\n"
        if command == "SAI?":
            return _lines(list(self.voltage))
        if command == "SVA?":
            return _lines([f"{axis}={self.voltage[axis]:.9f}" for axis in axes])
        if command == "POS?":
            return _lines([f"{axis}={GAIN * self.voltage[axis]:.9f}" for axis in axes])
        if command == "ERR?":
            error, self.error = self.error, 0
            return f"{error}\n"
        if command == "SVO":
            self.servo.update({axis: value != "0" for axis, value in zip(rest[::2], rest[1::2])})
        elif command == "SVA":
            for axis, value in zip(rest[::2], rest[1::2]):
                self._set(axis, float(value))
        else:
            self.lost.append(command)
            self.error = UNKNOWN
        return ""

    def _set(self, axis: str, volts: float) -> None:
        if self.servo[axis]:
            self.error = SERVO_IS_ON
        elif not RANGE[0] <= volts <= RANGE[1]:
            self.error = OUT_OF_LIMITS
        else:
            self.voltage[axis] = volts

    def __enter__(self) -> GcsController:
        return self

    def __exit__(self, *error: object) -> None:
        self._server.shutdown()
        self._server.server_close()


def _lines(lines: list[str]) -> str:
    """An answer of several lines: all but the last end with a blank."""
    return " \n".join(lines) + "\n"
