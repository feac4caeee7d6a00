# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""HAMPI feedforward node."""

from __future__ import annotations

from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.feedforward import Feedforward


class HampiFeedforward(Feedforward):
    """Feedforward node whose default compensator is of the kind `hampi`."""

    KIND = "hampi"


main = executable(HampiFeedforward)

if __name__ == "__main__":
    raise SystemExit(main())
