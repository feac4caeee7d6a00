"""The identification node: fits a model to recorded bags, on request or once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hyst_control.errors import InputError
from hyst_control.identify.estimator import described, every_option
from hyst_control.identify.options import Option
from hyst_control.identify.workflow import identify_bags
from hyst_control.nodes.base import EndingNode
from hyst_control.nodes.parameters import Setting, declare
from hyst_control.nodes.run import main as run_main


@dataclass(frozen=True)
class FamilyOption(Setting):
    """An option of some model families; empty: not given. Any type that one of them takes, or its text."""

    families: Mapping[str, Option] = field(default_factory=dict)

    def convert(self, value: object) -> object:
        """Return the value as given. Raises `InputError` where it is an option of no family."""
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
    """Return the node's parameters for the options of every model family."""
    return tuple(
        FamilyOption(name, "joint" if name == "method" else "", "", described(families), live=True, families=families)
        for name, families in every_option().items()
    )


class Identification(EndingNode):
    """Does what `hyst identify` does with the parameters as they stand, when `~/identify` is called, or with `once` and ends.

    The service answers with the fit's summary, or with the reason why there is none. A fit takes seconds, in which the node
    does nothing else; the loop's nodes are other nodes.
    """

    SETTINGS = (
        Setting("bags", ("",), "", "bags with command and measurement, fitted together", live=True),
        Setting("family", "", "", "model family, such as hapi or hampi; empty for the best one on held-out data", live=True),
        Setting("output", "", "", "model file to write", live=True),
        Setting("json", "", "", "fit report to write", live=True),
        Setting("once", False, "", "identify at the start and end"),
        *family_settings(),
    )

    def __init__(self, name: str = "identification", **options: Any) -> None:
        super().__init__(name, **options)
        self.settings = declare(self, self.SETTINGS, lambda name, value: None)
        self.ends = self.settings.once
        self.service("identify", self._identify)
        if self.ends:
            self.once(self._identify_and_end)

    def _identify(self) -> str:
        given = self.settings
        for name in ("bags", "output"):
            if not any(getattr(given, name)):
                raise InputError(f"{self.get_name()}: parameter {name}: is empty: set it first")
        options = {name: getattr(given, name) for name in every_option() if getattr(given, name) != ""}
        result = identify_bags(given.bags, given.family or None, given.output, json_path=given.json or None, **options)
        return result.text()

    def _identify_and_end(self) -> None:
        try:
            self.get_logger().info(self._identify())
            self.finished.set_result(0)
        except InputError as error:
            self.get_logger().error(str(error))
            self.finished.set_result(2)


def main() -> int:
    """The executable."""
    return run_main(Identification)


if __name__ == "__main__":
    raise SystemExit(main())
