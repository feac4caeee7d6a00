# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification node: fits a model to recorded bags, on request or once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.identify.families.estimator import described, every_option
from hyst_control.identify.families.options import Option
from hyst_control.identify.workflow import identify_bags
from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.parameters import Setting, declare


@dataclass(frozen=True)
class FamilyOption(Setting):
    """Parameter for an option of one or several model families.

    Its value has any type that one of the families accepts, or is the text of such a value; an empty text means not given.
    """

    families: Mapping[str, Option] = field(default_factory=dict)  # The option as each family declares it

    def checked(self, value: object) -> object:
        if isinstance(value, str) and value == "":
            return value
        given = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else value
        refused: InputError | None = None
        for option in self.families.values():
            try:
                option.checked(given)
                return given
            except InputError as error:
                refused = error
        raise refused or InputError(f"{self.name}: no family has this option")


def family_settings() -> tuple[FamilyOption, ...]:
    """Parameters of the node for the options of all model families."""
    return tuple(
        FamilyOption(name, "joint" if name == "method" else "", "", described(families), live=True, families=families)
        for name, families in every_option().items()
    )


class Identification(EndingNode):
    """Node that runs `hyst identify` with its parameters, whenever `~/identify` is called, or once at the start with `once`.

    The service answers with the summary of the fit, or with the reason of a failure. A fit takes seconds, in which this node does
    nothing else; the nodes of the loop are not affected. Whoever reaches the node may set its parameters and call it, so it writes
    within one folder only, which is set at its start.
    """

    SETTINGS = (
        Setting("bags", ("",), "", "bags with command and measurement, fitted together", live=True),
        Setting("family", "", "", "model family, such as hapi or hampi; empty for the best one on held-out data", live=True),
        Setting("output", "", "", "model file to write, within the folder", live=True),
        Setting("json", "", "", "fit report to write, within the folder", live=True),
        Setting("folder", "", "", "only folder that is written to; if empty, that of output at the start, else the current one"),
        Setting("once", False, "", "identify at the start, then end"),
        *family_settings(),
    )

    def __init__(self, name: str = "identification", **options: Any) -> None:
        super().__init__(name, **options)
        self.settings = declare(self, self.SETTINGS, lambda name, value: None)
        self.ends = self.settings.once
        given = self.settings
        self._folder = Path(os.path.realpath(given.folder or Path(given.output).parent))
        self.service("identify", self._identify)
        if self.ends:
            self.once(self._identify_and_end)

    def _identify(self) -> str:
        given = self.settings
        for name in ("bags", "output"):
            if not any(getattr(given, name)):
                raise InputError(f"{self.get_name()}: parameter {name}: must not be empty: set it first")
        output, report = self._within("output"), self._within("json") if given.json else None
        options = {name: getattr(given, name) for name in every_option() if getattr(given, name) != ""}
        result = identify_bags(given.bags, given.family or None, output, json_path=report, **options)
        result.written()
        return result.text()

    def _within(self, name: str) -> str:
        """Path of an output, with its links resolved. Raises `InputError` where it lies outside the folder."""
        given = getattr(self.settings, name)
        try:
            path = Path(os.path.realpath(given))
        except ValueError:  # a NUL in a name
            path = Path("/")
        if self._folder not in path.parents:
            raise InputError(
                f"{self.get_name()}: parameter {name}: {given!r} is not within {self._folder}: start the node with the parameter "
                "folder set to where it may write"
            )
        return str(path)

    def _identify_and_end(self) -> None:
        try:
            self.get_logger().info(self._identify())
            self.finished.set_result(0)
        except InputError as error:
            self.get_logger().error(str(error))
            self.finished.set_result(2)


main = executable(Identification)

if __name__ == "__main__":
    raise SystemExit(main())
