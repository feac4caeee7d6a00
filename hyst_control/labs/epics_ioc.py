# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""EPICS soft IOC around a control loop, by caproto; docs/labs.md lists its process variables."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.export.programs import controller
from hyst_control.labs.control_loop import ControlLoop, Driver, SimulatedDriver

PUBLISHED = 0.1  # s, between two values of a process variable


def database(loop: ControlLoop, prefix: str) -> dict[str, Any]:
    """Process variables of a loop, by name, for a caproto server."""
    try:
        from caproto import ChannelType
        from caproto.server import PVGroup, pvproperty
    except ModuleNotFoundError:
        raise InputError("caproto is not installed: pip install caproto") from None
    variables: dict[str, Any] = {}

    def shown(name: str, value: Any, read: Any, **options: Any) -> None:
        """A variable that is read from the loop, over and over."""

        async def scan(group: Any, instance: Any, library: Any) -> None:
            await instance.write(read())

        variables[name] = pvproperty(value=value, name=name, read_only=True, **options).scan(period=PUBLISHED)(scan)

    def given(name: str, value: Any, write: Any, **options: Any) -> None:
        """A variable that is written to the loop."""

        async def put(group: Any, instance: Any, new: Any) -> None:
            write(new)

        variables[name] = pvproperty(value=value, name=name, **options).putter(put)

    def enabled(value: Any) -> None:
        loop.enabled = bool(value)

    for at, axis in enumerate(loop.axes):
        place, unit = f"{axis.upper()}:", {"units": loop.unit, "precision": 4}
        given(f"{place}SETPOINT", float(loop.target[at]), lambda value, at=at: loop.move(at, float(value)), **unit)
        shown(f"{place}REFERENCE", 0.0, lambda at=at: float(loop.reference[at]), **unit)
        shown(f"{place}READBACK", 0.0, lambda at=at: float(loop.measurement[at]), **unit)
        shown(f"{place}COMMAND", 0.0, lambda at=at: float(loop.command[at]), units="V", precision=4)
    given("ENABLE", 1, enabled)
    shown("FAULT", "none", lambda: loop.fault, dtype=ChannelType.STRING)
    shown("TICKS", 0, lambda: loop.ticks)
    shown("MISSED", 0, lambda: loop.missed)
    names = {name: name.replace(":", "_").lower() for name in variables}
    group = type("Stage", (PVGroup,), {names[name]: variable for name, variable in variables.items()})
    return dict(group(prefix=prefix).pvdb)


def driver_of(words: str) -> Driver:
    """An instance of the class `MODULE:CLASS`."""
    module, _, name = words.partition(":")
    try:
        made: Driver = getattr(import_module(module), name)()
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"--driver: {words}: {error}: give MODULE:CLASS of a class with read and write") from None
    return made


def main(words: list[str] | None = None) -> int:
    """Run the server until it is interrupted; its exit status."""
    parser = argparse.ArgumentParser(prog="epics_ioc", description="EPICS soft IOC around a stage's control loop (docs/labs.md)")
    parser.add_argument("parameters", metavar="PARAMETERS.yaml", help="file of nodes' parameters, as hyst export takes it")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--driver", metavar="MODULE:CLASS", help="class with read() and write(command)")
    source.add_argument("--model", metavar="MODEL.yaml", help="simulate a model in the place of a stage")
    parser.add_argument("--prefix", default="STAGE:", help="beginning of all names (default STAGE:)")
    parser.add_argument("--speed", type=float, default=100.0, help="of the reference, unit per s (default 100)")
    parser.add_argument(
        "--interface",
        default="127.0.0.1",
        help="address to serve on (default 127.0.0.1: this machine alone; 0.0.0.0: every network)",
    )
    given = parser.parse_args(words)
    os.environ.setdefault("EPICS_CAS_BEACON_ADDR_LIST", given.interface if given.interface != "0.0.0.0" else "255.255.255.255")
    os.environ.setdefault("EPICS_CAS_AUTO_BEACON_ADDR_LIST", "NO")
    try:
        if given.driver:
            driver = driver_of(given.driver)
        else:
            driver = SimulatedDriver(given.model, controller(given.parameters).program.sample_time)
        loop = ControlLoop.from_file(given.parameters, driver, given.speed)
        variables = database(loop, given.prefix)
        from caproto.asyncio.server import run

        loop.start()
    except InputError as error:
        print(f"epics_ioc: {error}", file=sys.stderr)
        return 2
    try:
        run(variables, interfaces=[given.interface], log_pv_names=True)
    finally:
        loop.stop()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
