# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Estimators by name, one for each model family, with one interface.

A family is one class: its `Options`, which the command line, the node's parameters and the documents are derived from, and
`fit_axis(records, index, options) -> AxisFit`. Every module of `hyst_control.identify` is searched for them, so that a new family is one
new file; another distribution names its class as an entry point of the group `hyst_control.estimators`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from pkgutil import walk_packages
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

from hyst_control.base import plugins
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import shown
from hyst_control.identify.assess.assembly import AxisFit, fit_of
from hyst_control.identify.data.fit import Fit, check_records
from hyst_control.identify.families.options import Option, Options, declared
from hyst_control.records.record import Record

O = TypeVar("O", bound=Options)  # noqa: E741
E = TypeVar("E", bound="type[Estimator[Any]]")


RESERVED_NAMES = frozenset("allow_gaps bags family figure help hold json model namespace once output quiet start unit".split())
"""Names that options may not have: `hyst identify` and the node use them."""


class Estimator(Generic[O]):
    """Identification of one model family.

    Subclasses set `name` (as in `--model`), `sentence` (the model and its fit) and `Options` (a dataclass derived from
    `options.Options`), and implement `fit_axis`, or `fit` where axes are not fitted one by one.
    """

    name: ClassVar[str] = ""
    sentence: ClassVar[str] = ""
    suggested: ClassVar[bool] = False
    """Mark of the families that are compared on held-out data when none is named: its report has `held_out_nrmse`."""
    second_choice: ClassVar[bool] = False
    """Mark of the families, slower to fit, that are compared as well where none of the suggested ones does well; the same holds."""
    frees_states: ClassVar[bool] = False  # Mark of the families whose fit estimates the state with which the dynamics begin
    Options: type[O]

    def fit(self, records: Sequence[Record], options: O) -> Fit:
        """Identify a model from `records` of one plant with `options`; raises `InputError` where they do not determine one."""
        check_records(records)
        axes = [self.fit_axis(records, index, options) for index in range(len(records[0].axes))]
        return fit_of(records, axes, self.name, options.method)

    def fit_axis(self, records: Sequence[Record], index: int, options: O) -> AxisFit:
        """Fit the axis `index` of the `records` with `options`."""
        raise NotImplementedError

    @property
    def declared(self) -> tuple[Option, ...]:
        """The family's options."""
        return declared(self.Options)

    @property
    def methods(self) -> tuple[str, ...]:
        """Ways in which the family can be identified, the default one first."""
        return next(each.choices for each in self.declared if each.name == "method")

    def is_promising(self, axes: int, linear: bool) -> bool:
        """Report whether to compare a family where no suggested one does well; `linear`: whether a linear reference does better."""
        return self.second_choice

    def has(self, values: Iterable[str]) -> bool:
        """Report whether the family has options of all these names, `values`."""
        return set(values) <= {each.name for each in self.declared}

    def options(self, **values: object) -> O:
        """Construct the family's options from values or their texts."""
        known = [each.name for each in self.declared]
        for name in values:
            if name not in known:
                raise InputError(f"{name}: {self.name} has no such option: it has {', '.join(known)}")
        try:
            return self.Options(**values)  # type: ignore[arg-type]  # converted and checked by the class
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None


_ESTIMATORS: dict[str, Estimator[Any]] = {}


def register(estimator: E) -> E:
    """Class decorator that makes a family known by its name.

    Parameters
    ----------
    estimator
        A class derived from `Estimator`, with `name`, `sentence` and `Options`.

    Returns
    -------
    type
        The same class.

    Raises
    ------
    InputError
        It has no name or sentence, its name is another's, or its options are not declared by `option`.
    """
    name = estimator.name
    instance = estimator()
    if not name or not estimator.sentence or not hasattr(instance, "Options"):
        raise InputError(f"{estimator.__module__}.{estimator.__qualname__}: must have name, sentence and Options: add them")
    if name in _ESTIMATORS:
        raise InputError(f"{name}: the family is already registered by {type(_ESTIMATORS[name]).__module__}: choose another name")
    for each in declared(instance.Options):
        if each.name in RESERVED_NAMES:
            raise InputError(
                f"{name}: {each.name}: is already an option of the command or a parameter of the node: choose another name"
            )
    _ESTIMATORS[name] = instance
    return estimator


def estimators() -> Mapping[str, Estimator[Any]]:
    """Return every family by name: those of this package in the order of its modules, then those of plugins."""
    own = _search()
    ordered = sorted(
        _ESTIMATORS.items(), key=lambda item: (type(item[1]).__module__ not in own, type(item[1]).__module__.rpartition(".")[2])
    )
    return MappingProxyType(dict(ordered))


@cache
def _search() -> frozenset[str]:
    """Import every module of this package, then the plugins; the names of this package's modules."""
    package = "hyst_control.identify"
    names = [module.name for module in walk_packages(import_module(package).__path__, f"{package}.")]
    for name in names:
        import_module(name)
    plugins.load("estimators", _add)
    return frozenset(names)


def _add(name: str, value: object) -> None:
    """Make a plugin's family known, unless its class has done so by the decorator."""
    if not (isinstance(value, type) and issubclass(value, Estimator) and value.name == name):
        raise InputError(f"{value!r} is not an Estimator of this name")
    if type(_ESTIMATORS.get(name)) is not value:
        register(value)


def every_option() -> dict[str, dict[str, Option]]:
    """Return the options of all families: by name, then by family."""
    found: dict[str, dict[str, Option]] = {}
    for family, estimator in estimators().items():
        for each in estimator.declared:
            found.setdefault(each.name, {})[family] = each
    return found


def described(options: Mapping[str, Option]) -> str:
    """Describe one option of several families in a line: meaning, range, families and defaults.

    Parameters
    ----------
    options
        The option by family.

    Returns
    -------
    str
        The line.
    """
    option = max(options.values(), key=lambda each: len(each.choices))
    defaults: dict[str, list[str]] = {}
    for family, each in options.items():
        if each.default is not None:
            defaults.setdefault(shown(each.default), []).append(family)
    if len(defaults) > 1:
        words = [f"default {value} for {', '.join(families)}" for value, families in defaults.items()]
    else:
        words = [*([f"default {value}" for value in defaults] or ["chosen unless given"]), f"of {', '.join(options)}"]
    return f"{option.meaning}: {option.requirement} ({'; '.join(words)})"


def estimator_of(family: str) -> Estimator[Any]:
    """Return a family's estimator.

    Parameters
    ----------
    family
        Name of the family.

    Returns
    -------
    Estimator[Any]
        The estimator.

    Raises
    ------
    InputError
        There is no such family; the message lists those there are.
    """
    known = estimators()
    if family not in known:
        raise InputError(f"model: {family!r} is not a model family: use one of {', '.join(known)}")
    return known[family]
