# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Plugins: stages, effects, estimators, controllers and subcommands of other distributions, found through their entry points.

A distribution names them in its metadata, under `hyst_control.stages`, `.effects`, `.estimators`, `.controllers` or `.commands`; the
entry point's name is the name in model files, in reports and on the command line. One that cannot be imported, or is something else, is
reported in one line, and the others load.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cache
from importlib import metadata
from typing import Any, TypeVar, cast

from hyst_control.base.errors import InputError

GROUPS = ("stages", "effects", "estimators", "controllers", "commands")

Item = TypeVar("Item")


@cache
def _all_entry_points() -> Any:
    return metadata.entry_points()


def entry_points(group: str) -> metadata.EntryPoints:
    """Entry points of a group; the metadata of all distributions are read once."""
    return cast(metadata.EntryPoints, _all_entry_points().select(group=group))


def load(group: str, add: Callable[[str, object], object]) -> None:
    """Import every plugin of a group; a log line of level WARNING names the distribution of each that is unusable."""
    # add: called with the name and the value of each; an exception makes the plugin unusable
    assert group in GROUPS
    for point in sorted(entry_points(group=f"hyst_control.{group}"), key=lambda point: point.name):
        try:
            add(point.name, point.load())
        except (Exception, SystemExit) as error:  # of any kind: it is foreign code
            logging.getLogger("hyst_control").warning("%s", _line(group, point, error))


def _line(group: str, point: metadata.EntryPoint, error: BaseException) -> str:
    where = "an unknown distribution" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return f"plugin {point.name} (hyst_control.{group}) of {where}: cannot be used ({reason}): update or uninstall {where}"


class Registry(MutableMapping[str, Item]):
    """Members of one group by name: those of this package, and those of plugins, which are imported at the first lookup.

    They are not imported earlier, since a plugin's modules import this package.
    """

    def __init__(
        self,
        group: str,
        expected: str,
        fits: Callable[[str, object], bool],
        own: Mapping[str, Item] | None = None,
        order: Callable[[Item], tuple[int | str, ...]] | None = None,
    ) -> None:
        self._group, self._expected, self._fits, self._order = group, expected, fits, order
        self._known: dict[str, Item] = {}
        self._loaded = False
        self._keep(own or {})

    def __getitem__(self, name: str) -> Item:
        return self._all()[name]

    def added(self, name: str) -> Item | None:
        """Return the member of a name among those added so far, without looking for plugins; None where there is none."""
        return self._known.get(name)

    def __setitem__(self, name: str, value: Item) -> None:
        self._known[name] = value

    def __delitem__(self, name: str) -> None:
        del self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def _all(self) -> dict[str, Item]:
        if not self._loaded:
            self._loaded = True
            load(self._group, self._add)
        return self._known

    def _add(self, name: str, value: object) -> None:
        if not self._fits(name, value):
            raise InputError(f"{value!r} is not {self._expected}")
        if self._known.get(name, value) is not value:
            raise InputError("another plugin or this package has the name")
        self._keep({name: cast(Item, value)})

    def _keep(self, more: Mapping[str, Item]) -> None:
        known = {**self._known, **more}
        if self._order is not None:
            order = self._order
            known = dict(sorted(known.items(), key=lambda item: order(item[1])))
        self._known = known
