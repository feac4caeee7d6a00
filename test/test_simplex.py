# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The simplex goes as that of SciPy does, step by step."""

import numpy as np
import pytest
from scipy.optimize import minimize

from hyst_control.base.simplex import lowest


def rosenbrock(x):
    return float((1.0 - x[0]) ** 2 + 100.0 * (x[1] - x[0] ** 2) ** 2)


def with_a_wall(x):
    return 1e300 if x[0] < -1.1 else float(np.sum(np.abs(x) ** 1.5) + np.sin(3.0 * x[0]))


@pytest.mark.parametrize(("function", "count", "steps"), [(rosenbrock, 2, 400), (rosenbrock, 2, 7), (with_a_wall, 4, 400)])
def test_it_takes_the_steps_of_another_implementation(function, count, steps):
    tried = ([], [])
    for seed in range(5):
        first = np.random.default_rng(seed).normal(size=count)
        simplex = np.vstack([first, first + 0.3 * np.eye(count)])
        options = {"xatol": 1e-3, "fatol": 1e-3, "maxiter": steps, "initial_simplex": simplex}
        due = minimize(lambda x: (tried[0].append(x.tolist()), function(x))[1], first, method="Nelder-Mead", options=options)
        point, value = lowest(lambda x: (tried[1].append(x.tolist()), function(x))[1], simplex, 1e-3, 1e-3, steps)
        assert np.array_equal(point, due.x) and value == due.fun
    assert tried[0] == tried[1]
