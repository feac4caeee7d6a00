# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Type of arrays in signatures."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
