"""The HAMPI feedforward node."""

from __future__ import annotations

from typing import Any

from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.run import main as run_main


class HampiFeedforward(Feedforward):
    """A feedforward whose compensator is of the kind `hampi` unless another is asked for."""

    KIND = "hampi"

    def __init__(self, name: str = "hampi_feedforward", **options: Any) -> None:
        super().__init__(name, **options)


def main() -> int:
    """The executable."""
    return run_main(HampiFeedforward)


if __name__ == "__main__":
    raise SystemExit(main())
