# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Types of arrays in signatures."""

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]


def _put_off(parent: str, name: str) -> None:
    """Let a module be loaded when something of it is used, not when its parent is imported by star."""
    spec = find_spec(f"{parent}.{name}")
    if spec is None or spec.loader is None or spec.name in sys.modules:
        return
    spec.loader = LazyLoader(spec.loader)
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    setattr(sys.modules[parent], name, module)
    spec.loader.exec_module(module)


_put_off(
    "numpy", "f2py"
)  # scipy takes all names of numpy, and with them a Fortran parser that costs every command a tenth of a second
