# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""MHL feedforward node."""

from __future__ import annotations

from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.feedforward import Feedforward


class MhlFeedforward(Feedforward):
    """Feedforward node whose default compensator is of the kind `mhl`."""

    KIND = "mhl"


main = executable(MhlFeedforward)

if __name__ == "__main__":
    raise SystemExit(main())
