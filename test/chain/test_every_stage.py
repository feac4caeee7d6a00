# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Properties that every registered stage has: blocks do not matter, and rest is rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyst_control.effects  # noqa: F401  (makes the effects' stages known)
from hyst_control.chain import STAGES, Chain, Sampling
from hyst_control.chain.command_features import FEATURES
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayOperator, PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain

SAMPLE_TIME = 1e-4
RISING, FALLING = [0.2, 0.5, 0.3], [-0.3, -0.2, 1.5]
"""A Madelung pair in closed form: x³/5 + x²/2 + 3x/10 below, its mirror image 1 - f(1 - x) above."""


def spread(axes: int, *choices: object) -> object:
    """One parameter value for one axis, a list of them, cyclically, for more."""
    return choices[0] if axes == 1 else [choices[i % len(choices)] for i in range(axes)]


EXAMPLES = {
    "gain": lambda n: {"gain": spread(n, 1.7, -0.3)},
    "offset": lambda n: {"offset": spread(n, 0.4, -2.0)},
    "saturation": lambda n: {"lower": spread(n, 10.0, 20.0), "upper": spread(n, 70.0, 50.0)},
    "quantization": lambda n: {"step": spread(n, 0.1, 2.5)},
    "delay": lambda n: {"tau": spread(n, 2.3e-4, 7e-5, 1.0e-3)},
    "transfer_function": lambda n: {"num": spread(n, [1e4, 4e7], [3e7]), "den": spread(n, [1.0, 900.0, 4e7], [1.0, 400.0, 3e7])},
    "state_space": lambda n: {
        "A": (-np.diag([800.0, 3000.0, 9000.0])[:n, :n]).tolist(),
        "B": np.full((n, n), 500.0).tolist(),
        "C": (np.eye(n) + 0.1).tolist(),
        "D": (0.2 * np.eye(n)).tolist(),
    },
    "rate_correction": lambda n: {"k1": spread(n, -1e-3, 2e-3), "k2": spread(n, 7e-4, 3e-4), "b1": spread(n, 0.1, 0.0)},
    "cross_coupling": lambda n: {"matrix": (np.eye(n) + 0.03 - 0.01 * np.tri(n)).tolist(), "corner": 300.0},
    "parallel": lambda n: {"branches": ((Gain(0.5),), (PlayOperator(3.0), Gain(0.2)))},
    "play_operator": lambda n: {"threshold": spread(n, 5.0, 12.0)},
    "prandtl_ishlinskii": lambda n: {
        "thresholds": spread(n, [0.0, 4.0, 11.0], [1.0, 9.0]),
        "weights": spread(n, [0.2, 0.5, -0.1], [0.3, 0.4]),
        "w0": 0.3,
    },
    "rate_dependent_prandtl_ishlinskii": lambda n: {
        "thresholds": spread(n, [2.0, 7.0], [1.0]),
        "weights": spread(n, [0.4, 0.3], [0.9]),
        "beta": spread(n, 1e-5, 0.0),
    },
    "modified_prandtl_ishlinskii": lambda n: {
        "thresholds": spread(n, [0.5, 5.5, 20.0], [1.0, 30.0]),
        "one_sided": True,
        "weights": spread(n, [0.5, 0.2, 0.3], [0.6, -0.1]),
        "m1": spread(n, 8e-7, 0.0),
        "m2": 3e-7,
        "k": spread(n, -6e-4, 1e-4),
        "b": 0.02,
    },
    "madelung": lambda n: {
        "ascending": spread(n, RISING, FALLING),
        "descending": spread(n, FALLING, FALLING),
        "input_scale": spread(n, 100.0, 80.0),
        "output_scale": spread(n, 2.0, 0.6),
    },
    "duhem": lambda n: {
        "slope": spread(n, 0.1, 0.12),
        "alpha": spread(n, -0.03, -0.01),
        "beta": 0.02,
        "gamma": spread(n, -0.006, 0.004),
        "exponent": spread(n, 1.0, 2.0),
        "growth": 4e-3,
    },
    "creep_operators": lambda n: {"times": [2e-4, 1e-3], "shares": spread(n, [0.05, 0.02], [0.01, 0.03])},
    "softening_modal": lambda n: {
        "decay": [5.0, 6.0],
        "frequency": [2e3, 0.0],
        "decay_change": [0.1, 0.0],
        "frequency_change": [-50.0, 0.0],
        "outputs": [np.full((2, n), 0.3).tolist(), [[0.1] * n, [0.0] * n]],
        "inputs": [np.full((2, n), 100.0).tolist(), [[20.0] * n, [0.0] * n]],
        "feedthrough": (0.1 * np.eye(n)).tolist(),
        "elongation": np.eye(n).tolist(),
        "force_inputs": [np.full((2, n), 1e-3).tolist(), [[1e-3] * n, [0.0] * n]],
        "stop_threshold": 8.0,
        "stop_inputs": [np.full((2, n), 10.0).tolist(), [[2.0] * n, [0.0] * n]],
        "stop_feedthrough": (0.01 * np.eye(n)).tolist(),
        "stop_mean": 0.2,
        "product_inputs": [
            np.full((2, n * (n + 1) // 2), 3e-3).tolist(),
            [[1e-3] * (n * (n + 1) // 2), [0.0] * (n * (n + 1) // 2)],
        ],
        "product_feedthrough": np.full((n, n * (n + 1) // 2), 1e-6).tolist(),
        "product_mean": 0.8,
        "amplitude": 50.0,
        "memory": 0.02,
    },
    "bouc_wen": lambda n: {
        "mass": spread(n, 5e-7, 1e-6),
        "damping": spread(n, 3e-3, 6e-3),
        "stiffness": spread(n, 1.0, 2.0),
        "alpha": spread(n, 1.0, 0.5),
        "beta": spread(n, 0.02, 0.05),
        "gamma": spread(n, 0.01, -0.02),
    },
    "duhem_oscillator": lambda n: {
        "mass": spread(n, 5e-7, 1e-6),
        "damping": spread(n, 3e-3, 6e-3),
        "stiffness": spread(n, 1.0, 2.0),
        "knots": spread(n, [-30.0, 5.0, 40.0], [-20.0, 20.0]),
        "rising": spread(n, [1.5, 1.0, 0.4], [0.8, 0.2]),
        "falling": spread(n, [0.3, 0.9, 1.6], [0.1, 0.9]),
    },
    "creep": lambda n: {"gamma": spread(n, 0.03, -0.02)},
    "hysteresis_width": lambda n: {"width": spread(n, 0.3, -0.2)},
    "hysteresis_shape": lambda n: {"amount": spread(n, 0.05, -0.02), "lower": 0.0, "upper": spread(n, 100.0, 80.0)},
    "hysteresis_rate": lambda n: {"factor": spread(n, 2.0, 0.0)},
    "amplifier_lowpass": lambda n: {"cutoff": spread(n, 2e3, np.inf), "order": spread(n, 1, 2)},
    "sensor_lowpass": lambda n: {"cutoff": spread(n, 1e3, np.inf, 5e3), "order": 2},
    "slew_limit": lambda n: {"rate": spread(n, 2e4, np.inf)},
    "dac_hold": lambda n: {"samples": spread(n, 3, 1), "step": spread(n, 0.5, 0.0)},
    "dry_friction": lambda n: {"slack": spread(n, 0.4, 0.0)},
    "cubic_stiffness": lambda n: {"loss": spread(n, 20.0, -10.0), "amplitude": 200.0},
    "clearance": lambda n: {"half_width": 0.3, "excess": spread(n, 0.2, -0.1)},
    "dead_zone": lambda n: {"half_width": spread(n, 2.0, 0.0), "center": spread(n, 0.0, 10.0)},
    "output_saturation": lambda n: {"lower": -np.inf, "upper": spread(n, 30.0, 20.0)},
    "softening_modes": lambda n: {"softening": spread(n, 0.02, 0.01), "damping": spread(n, 0.3, 0.1), "amplitude": 2.0},
    "resonance": lambda n: {"frequency": spread(n, 900.0, 300.0), "damping": 0.1, "gain": spread(n, 0.05, -0.1)},
    "coupled_resonance": lambda n: {
        "frequency": 900.0,
        "damping": 0.1,
        "in_phase": (0.05 * np.eye(n) - 0.02).tolist(),
        "quadrature": np.full((n, n), 0.01).tolist(),
    },
    "coupled_modes": lambda n: {
        "frequency": [900.0, 1500.0],
        "damping": [0.1, 1.2],
        "in_phase": [(0.05 * np.eye(n) - 0.02).tolist(), np.full((n, n), 0.02).tolist()],
        "quadrature": [np.full((n, n), 0.01).tolist(), np.diag(np.arange(n) * 0.01).tolist()],
        "static": np.full((n, n), -0.01).tolist(),
    },
    "learned_residual": lambda n: {
        "center": spread(n, 50.0, 40.0),
        "span": 100.0,
        "rate": spread(n, 2e4, 1e4),
        "lag": 4e-4,
        "duration": 0.01,
        "weights": spread(n, np.sin(np.arange(FEATURES)).tolist(), np.cos(np.arange(FEATURES)).tolist()),
        "constant": spread(n, 0.3, 0.0),
    },
    "added_mass": lambda n: {"mass_ratio": spread(n, 0.3, -0.2)},
    "backlash": lambda n: {"half_width": spread(n, 2.0, 0.0)},
    "vibration": lambda n: {"amplitude": spread(n, 0.5, 0.0), "frequency": 170.0, "phase": 1.0},
    "gain_drift": lambda n: {"change": spread(n, 0.1, 0.0), "tau": spread(n, 0.02, 0.1)},
    "offset_drift": lambda n: {"change": spread(n, 0.1, 0.0), "tau": spread(n, 0.02, 0.1)},
    "mains_hum": lambda n: {"amplitude": spread(n, 0.5, 0.0), "frequency": spread(n, 50.0, 60.0)},
    "sensor_nonlinearity": lambda n: {"second": spread(n, 0.5, 0.0), "third": 0.2, "lower": 0.0, "upper": 100.0},
    "sensor_noise": lambda n: {"rms": spread(n, 0.5, 0.0), "seed": 3},
    "flicker_noise": lambda n: {"rms": spread(n, 0.5, 0.0), "seed": 3},
    "held_samples": lambda n: {"fraction": spread(n, 0.3, 0.0)},
    "inverse_multiplicative": lambda n: {
        "thresholds": spread(n, [1.0, 9.0], [4.0]),
        "weights": spread(n, [0.5, 0.3], [0.9]),
        "w0": 0.3,
        "m1": spread(n, 1e-7, 0.0),
        "lower": -20.0,
        "upper": 150.0,
    },
}
"""Parameters of every stage for a number of axes, different from axis to axis where they may be."""

PLANT = (
    PrandtlIshlinskii([1.0, 9.0], [0.5, 0.4]),
    TransferFunction([4e7], [1.0, 900.0, 4e7]),
)
MODIFIERS = (
    "hysteresis_width",
    "hysteresis_shape",
    "hysteresis_rate",
    "resonance",
    "coupled_resonance",
    "coupled_modes",
    "added_mass",
    "softening_modes",
    "learned_residual",
    "dry_friction",
    "cubic_stiffness",
    "clearance",
)
BEFORE = dict.fromkeys(MODIFIERS, PLANT)
"""What stands before a stage that changes others."""

RESTLESS = ("creep", "learned_residual", "vibration", "gain_drift", "offset_drift", "mains_hum", "sensor_noise", "flicker_noise")
"""Stages whose output changes with time or at random while the input rests, or for hours before it rests too."""

VARIANTS = {
    "inverse_multiplicative, iterated": (
        "inverse_multiplicative",
        lambda n: {"thresholds": [1.0, 9.0], "weights": [0.5, 0.3], "lower": 0.0, "upper": spread(n, 90.0, 70.0), "iterations": 3},
    ),
    "prandtl_ishlinskii, one-sided": (
        "prandtl_ishlinskii",
        lambda n: {"thresholds": [1.0, 6.0], "weights": [0.5, 0.3], "one_sided": True},
    ),
    "inverse_multiplicative, levels": (
        "inverse_multiplicative",
        lambda n: {
            "thresholds": spread(n, [1.0, 9.0], [4.0]),
            "weights": spread(n, [0.5, 0.3], [0.9]),
            "levels": spread(n, [2e-4, -1e-4], [1e-4]),
            "center": spread(n, 40.0, 0.0),
            "w0": 0.3,
            "lower": 0.0,
            "upper": 150.0,
            "iterations": 0,
        },
    ),
    "modified_prandtl_ishlinskii, levels": (
        "modified_prandtl_ishlinskii",
        lambda n: {
            "thresholds": spread(n, [1.0, 6.0], [4.0]),
            "weights": spread(n, [0.5, 0.3], [0.9]),
            "levels": spread(n, [2e-3, -1e-3], [1e-3]),
            "center": spread(n, 40.0, 0.0),
        },
    ),
    "modified_prandtl_ishlinskii, two-sided": (
        "modified_prandtl_ishlinskii",
        lambda n: {"thresholds": [1.0, 6.0], "weights": [0.5, 0.3], "m1": 1e-6, "w0": 0.1},
    ),
    "cross_coupling, static": ("cross_coupling", lambda n: {"matrix": (np.eye(n) + 0.03).tolist()}),
    "state_space, discrete": (
        "state_space",
        lambda n: {
            "A": np.diag([0.9, 0.5, -0.2])[:n, :n].tolist(),
            "sample_time": SAMPLE_TIME,
            "B": np.ones((n, n)).tolist(),
            "C": np.eye(n).tolist(),
            "D": np.full((n, n), 0.1).tolist(),
        },
    ),
    "transfer_function, coupled": (
        "transfer_function",
        lambda n: {
            "coupled": True,
            "den": [1.0, 900.0, 4e7],
            "num": [[[1e4 if i == j else 2e3, 3e7 + 1e7 * (i - j)] for j in range(n)] for i in range(n)],
        },
    ),
    "bouc_wen, exponent": (
        "bouc_wen",
        lambda n: {"mass": 5e-7, "damping": 3e-3, "stiffness": 1.0, "alpha": 1.0, "beta": 1e-3, "exponent": spread(n, 1.7, 2.0)},
    ),
    "madelung, inverse": (
        "madelung",
        lambda n: {"ascending": RISING, "descending": FALLING, "input_scale": 100.0, "output_scale": 80.0, "inverse": True},
    ),
    "madelung, knots": (
        "madelung",
        lambda n: {
            "ascending": spread(n, [0.0, 0.3, 1.0], [0.0, 0.2, 1.0]),
            "knots": [0.0, 0.4, 1.0],
            "descending": [0.0, 0.6, 1.0],
            "input_scale": 100.0,
            "output_scale": 2.0,
        },
    ),
    "saturation, knee": (
        "saturation",
        lambda n: {"lower": spread(n, 10.0, -np.inf), "upper": spread(n, 70.0, 50.0), "knee": spread(n, 5.0, 2.0, 0.0)},
    ),
    "gain_drift, several time constants": (
        "gain_drift",
        lambda n: {
            "change": spread(n, 0.1, -0.2),
            "tau": spread(n, 0.02, 0.1),
            "decades": spread(n, 1.5, 0.0),
            "initial": -0.4,
            "onset": 3e-3,
        },
    ),
    "offset_drift, several time constants": (
        "offset_drift",
        lambda n: {
            "change": spread(n, 0.1, -2.0),
            "tau": 0.02,
            "decades": spread(n, 0.5, 3.0),
            "initial": spread(n, -1.0, 0.0),
            "lasts": spread(n, 0.01, 0.0),
            "smooth": 0.7,
        },
    ),
    "hysteresis_shape, behind": (
        "hysteresis_shape",
        lambda n: {"amount": 0.05, "odd": 0.02, "tilt": -0.03, "lower": 0.0, "upper": 100.0, "behind": spread(n, 1.0, 0.0)},
    ),
    "sensor_nonlinearity, to the fifth": (
        "sensor_nonlinearity",
        lambda n: {
            "second": 0.5,
            "third": 0.2,
            "lower": 0.0,
            "upper": 100.0,
            "zero": 0.1,
            "fourth": 0.3,
            "fifth": spread(n, 0.1, 0.2),
            "first": 0.04,
        },
    ),
    "madelung, bipolar": (
        "madelung",
        lambda n: {
            "ascending": RISING,
            "descending": FALLING,
            "input_scale": 150.0,
            "input_offset": spread(n, -80.0, -110.0),
            "output_scale": 2.0,
        },
    ),
}
CASES = {**{name: (name, make) for name, make in EXAMPLES.items()}, **VARIANTS}


def test_every_registered_stage_has_an_example():
    assert set(STAGES) == set(EXAMPLES), "add the parameters of a new stage to EXAMPLES: its blocks are then tested too"


def command(seed: int, rows: int, axes: int) -> np.ndarray:
    """A wandering command (rows, axes) in V with turns, plateaus and excursions beyond 0…100 V."""
    random = np.random.default_rng(seed)
    steps = random.normal(0.0, 12.0, (rows, axes)) * (random.random((rows, axes)) < 0.7)
    return 50.0 + 0.6 * np.cumsum(steps, axis=0)


def started(case: str, axes: int, hold: str):
    name, make = CASES[case]
    return Chain((*BEFORE.get(name, ()), STAGES[name](**make(axes)))).filter(Sampling(SAMPLE_TIME, axes, hold))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("case", CASES)
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), axes=st.integers(1, 3), cuts=st.lists(st.integers(0, 150), max_size=8))
def test_any_cutting_into_blocks_gives_the_same_bits(case, hold, seed, axes, cuts):
    u = command(seed, 150, axes)
    whole, cut = started(case, axes, hold), started(case, axes, hold)
    np.testing.assert_array_equal(whole.settle(u[0]), cut.settle(u[0]))
    pieces = [cut.process(np.ascontiguousarray(u[i:j])) for i, j in zip([0, *sorted(cuts)], [*sorted(cuts), 150])]
    np.testing.assert_array_equal(np.concatenate(pieces), whole.process(u))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("case", [case for case in CASES if CASES[case][0] not in RESTLESS])
def test_settle_is_where_a_long_constant_input_ends(case, hold):
    """From rest at 0, a slow rise and then a constant: the output must come to the settled one."""
    axes, value = 2, np.array([37.0, 61.0])
    settled = started(case, axes, hold).settle(value)
    slow = started(case, axes, hold)
    slow.settle(np.zeros(axes))
    # The rise ends gently: what looks at the rate would else go past the end of it.
    slow.process((1.0 - np.linspace(1.0, 0.0, 3000)[:, None] ** 6) * value)
    last = slow.process(np.tile(value, (2000, 1)))[-1]
    np.testing.assert_allclose(last, settled, rtol=1e-9, atol=1e-9)
    # And a filter that settled there stays there.
    resting = started(case, axes, hold)
    resting.settle(value)
    np.testing.assert_allclose(resting.process(np.tile(value, (5, 1))), np.tile(settled, (5, 1)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_settling_again_forgets_everything(case):
    u = command(5, 200, 2)
    running = started(case, 2, "zoh")
    running.settle(u[0])
    first = running.process(u)
    running.settle(u[0])
    np.testing.assert_array_equal(running.process(u), first)


@pytest.mark.parametrize("case", CASES)
def test_the_block_given_is_not_changed(case):
    u = command(7, 50, 2)
    copy = u.copy()
    running = started(case, 2, "zoh")
    running.settle(u[0])
    running.process(u)
    np.testing.assert_array_equal(u, copy)
