"""HAMPI feedforward node."""

from __future__ import annotations

from typing import Any

from hyst_control.nodes.execution.run import main as run_main
from hyst_control.nodes.feedforward import Feedforward


class HampiFeedforward(Feedforward):
    """Feedforward node whose default compensator is of the kind `hampi`."""

    KIND = "hampi"

    def __init__(self, name: str = "hampi_feedforward", **options: Any) -> None:
        super().__init__(name, **options)


def main() -> int:
    """Run the executable; its exit status."""
    return run_main(HampiFeedforward)


if __name__ == "__main__":
    raise SystemExit(main())
