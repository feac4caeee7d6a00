# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Show a running loop on a live page in the browser: signals, error, loop, gap, diagnostics, and buttons for enable, stop, reset, record.

The page is served on this computer only, at the printed address, which holds a token: whoever has the address can stop the loop and
record it. Give rate, axes, unit and schedule as the loop has them. The loop is disturbed least when the node `live_view` is composed with
it (`pipeline … live_view`); otherwise the dashboard subscribes to the signals themselves. Needs the extra: pip install
'hyst_control[dashboard]'. Ctrl-C ends it; the loop goes on.

examples:
  hyst dashboard --rate 1000
  hyst dashboard --rate 5000 --axes x y --unit mrad --schedule lockstep --folder records
"""

from __future__ import annotations

import argparse

NAME = "dashboard"
HELP = "show a running loop on a live page in the browser"
JSON = "address of the page, once it is served,"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("--rate", type=float, default=1000.0, help="sample rate of the signals in Hz (default 1000)")
    add("--axes", nargs="+", default=["x"], help="names of the axes (default x)")
    add("--unit", choices=("um", "mrad"), default="um", help="unit of reference and measurement (default um)")
    add("--schedule", choices=("timer", "lockstep"), default="timer", help="schedule of the loop (default timer)")
    add("--namespace", default="", help="namespace of the topics")
    add("--port", type=int, default=0, help="port of the page (default: a free one)")
    add("--window", type=float, default=10.0, help="time that the curves cover in s (default 10)")
    add("--folder", default="recordings", help="folder of the bags that the page records (default recordings)")


def run(arguments: argparse.Namespace) -> int:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from pathlib import Path

    from hyst_control.base.errors import InputError
    from hyst_control.base.files import write_json
    from hyst_control.nodes.dashboard import LoopSettings, serve

    if not 1e-3 <= arguments.rate <= 1e6:
        raise InputError(f"--rate: rate_hz must be 1e-3 to 1e6 Hz, got {arguments.rate!r}")
    if not 0 < arguments.window <= 3600:
        raise InputError(f"--window: must be > 0 and ≤ 3600, got {arguments.window!r}")
    if not 0 <= arguments.port < 65536:
        raise InputError(f"--port: must be 0 to 65535, got {arguments.port}")

    def opened(url: str) -> None:
        if arguments.json is not None:
            write_json(arguments.json, {"url": url}, private=True)
            arguments.publish()
        print(f"{url}\nCtrl-C ends the page; the loop goes on", flush=True)

    loop = LoopSettings(arguments.rate, arguments.schedule, tuple(arguments.axes), arguments.unit, arguments.namespace)
    return serve(loop, arguments.port, Path(arguments.folder), arguments.window, opened)
