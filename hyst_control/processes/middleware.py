"""Differences between the middlewares below ROS 2, chosen by RMW_IMPLEMENTATION; docs/middleware.md says what was tried."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError

DEFAULT = "rmw_fastrtps_cpp"


@dataclass(frozen=True)
class Middleware:
    """A middleware as the nodes meet it."""

    name: str  # Value of RMW_IMPLEMENTATION
    tried: bool = False  # Whether this package's tests have run on it
    settings: Mapping[str, str] = field(default_factory=dict)  # Variable, and the file in config/ that it names
    chosen_by: tuple[str, ...] = ()  # Variables of which any says that the user has settings of their own
    keeps_discovery_range: bool = True  # Whether it goes by ROS_AUTOMATIC_DISCOVERY_RANGE
    remedy: str = "see that its processes reach each other on this computer"  # Where messages do not arrive

    def set_defaults(self) -> None:
        """Name this package's settings in the environment, unless the user has some."""
        if any(variable in os.environ for variable in self.chosen_by):
            return
        for variable, file in self.settings.items():
            with suppress(InputError):  # an installation without its files
                os.environ[variable] = str(config_path(file))


def chosen() -> Middleware:
    """The middleware that RMW_IMPLEMENTATION names; one of which nothing is known where the name is new."""
    name = os.environ.get("RMW_IMPLEMENTATION") or DEFAULT
    if name.startswith("rmw_fastrtps"):
        return _fast_dds(name)
    return KNOWN.get(name, Middleware(name))


FAST_DDS_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
KNOWN = {
    middleware.name: middleware
    for middleware in (
        # Its writers announce by themselves every 0.1 s what they sent; shared memory is off unless CYCLONEDDS_URI asks for it.
        Middleware(
            "rmw_cyclonedds_cpp",
            chosen_by=("CYCLONEDDS_URI",),
            remedy="allow UDP and multicast on lo (a firewall? a VPN?), and see what CYCLONEDDS_URI names",
        ),
        # Over TCP to a router: nothing to announce again, and who reaches the router is a matter of the router's own settings.
        Middleware(
            "rmw_zenoh_cpp",
            chosen_by=("ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"),
            keeps_discovery_range=False,
            remedy="start the router: ros2 run rmw_zenoh_cpp rmw_zenohd",
        ),
    )
}


def _fast_dds(name: str) -> Middleware:
    """Fast DDS, whose version 3 (Kilted and later) renamed the variable and the tags of its settings."""
    third = any(
        Path(prefix, "share", "fastdds").is_dir() for prefix in [*os.environ.get("AMENT_PREFIX_PATH", "").split(":"), sys.prefix]
    )
    return Middleware(
        name,
        tried=name == DEFAULT,
        settings={FAST_DDS_VARIABLES[1]: "fastdds/loop_3.xml"} if third else {FAST_DDS_VARIABLES[0]: "fastdds/loop.xml"},
        chosen_by=FAST_DDS_VARIABLES,
        remedy="allow UDP and multicast on lo (a firewall? a VPN?), and see that /dev/shm is not full",
    )
