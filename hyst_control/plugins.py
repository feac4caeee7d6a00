"""Plugins: stages, effects, estimators and controllers of other distributions, found through their entry points.

A distribution names them in its metadata, under `hyst_control.stages`, `hyst_control.effects`, `hyst_control.estimators` or
`hyst_control.controllers`; the entry point's name is the name in model files, in reports and on the command line. One that cannot be
imported, or is something else, is told in one line, and does not take the rest down.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar, cast

from hyst_control.errors import InputError

GROUPS = ("stages", "effects", "estimators", "controllers")

Item = TypeVar("Item")


def load(group: str, add: Callable[[str, object], object] = lambda name, value: None) -> None:
    """Import every plugin of a group; a log line of level WARNING names the distribution of each that is unusable.

    Parameters
    ----------
    group
        One of `GROUPS`.
    add
        Called with the name and the value of each; what it raises makes the plugin unusable. By default importing is all: a
        module registers its own.
    """
    assert group in GROUPS
    for point in sorted(entry_points(group=f"hyst_control.{group}"), key=lambda point: point.name):
        try:
            add(point.name, point.load())
        except Exception as error:  # anything: it is other people's code
            logging.getLogger("hyst_control").warning("%s", _line(group, point, error))


def _line(group: str, point: EntryPoint, error: Exception) -> str:
    where = "an unknown distribution" if point.dist is None else f"{point.dist.name} {point.dist.version}"
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return f"plugin {point.name} (hyst_control.{group}) of {where}: cannot be used ({reason}): update or uninstall {where}"


class Registry(MutableMapping[str, Item]):
    """Things of one group by name: this package's own, and those of plugins, which are imported when one is first looked up.

    Not earlier: a plugin's modules import this package, and may be imported before it.

    Parameters
    ----------
    group
        One of `GROUPS`.
    due
        Description of a member, for the refusal of a plugin that is none.
    fits
        Whether a plugin's value of a name is a member.
    own
        This package's members.
    order
        Sorting key of a member; without one they stand in the order in which they came.
    """

    def __init__(
        self,
        group: str,
        due: str,
        fits: Callable[[str, object], bool],
        own: Mapping[str, Item] | None = None,
        order: Callable[[Item], tuple[int | str, ...]] | None = None,
    ) -> None:
        self._group, self._due, self._fits, self._order = group, due, fits, order
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
            raise InputError(f"{value!r} is not {self._due}")
        if self._known.get(name, value) is not value:
            raise InputError("the name is taken")
        self._keep({name: cast(Item, value)})

    def _keep(self, more: Mapping[str, Item]) -> None:
        known = {**self._known, **more}
        if self._order is not None:
            order = self._order
            known = dict(sorted(known.items(), key=lambda item: order(item[1])))
        self._known = known
