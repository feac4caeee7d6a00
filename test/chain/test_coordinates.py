"""Numbers in which a chain's uncertainty is stated: names, values there and back, and stability however they scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hyst_control.base.config_files import config_path
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.chain.linear.rational_factors import factors, rational
from hyst_control.model_file import load_model, simulate

MODE = [1.0, 2 * 0.05 * 2 * np.pi * 900.0, (2 * np.pi * 900.0) ** 2]


def test_factors_are_those_a_polynomial_was_made_of():
    num = 3.0 * np.polymul([1.0, 2 * 0.01 * 2 * np.pi * 400, (2 * np.pi * 400) ** 2], [-1e-4, 1.0])
    den = np.polymul(np.polymul(MODE, [1.0, 2 * np.pi * 30.0]), [1.0, 2 * np.pi * 300.0])
    found = factors(num, den)
    expected = {
        "gain": num[-1] / den[-1],
        "frequency[0]": 900.0,
        "damping[0]": 0.05,
        "corner[0]": 30.0,
        "corner[1]": 300.0,
        "zero_frequency[0]": 400.0,
        "zero_damping[0]": 0.01,
        "lead[0]": -1e-4,
    }
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].value == pytest.approx(value, rel=1e-9), name


@pytest.mark.parametrize("order", range(1, 7))
def test_factors_make_the_polynomials_again(order):
    random = np.random.default_rng(order)
    for _ in range(20):
        den = np.poly(-np.exp(random.uniform(2, 9, order)))
        num = random.normal(size=order) * den[1:]
        again = rational(num, den, {})
        w = 1j * np.geomspace(1.0, 1e5, 50)
        before, after = (np.polyval(n, w) / np.polyval(d, w) for n, d in ((num, den), again))
        np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-9 * np.abs(before).max())
        assert again[1][0] == pytest.approx(den[0])


def test_no_scatter_of_frequencies_and_dampings_is_unstable():
    """Independent scatter of the coefficients by 30 % is unstable in most draws."""
    random = np.random.default_rng(0)
    den = np.polymul(MODE, [1.0, 2 * 0.02 * 2 * np.pi * 1100.0, (2 * np.pi * 1100.0) ** 2])
    num = den[-1:]
    nominal = factors(num, den)
    unstable = 0
    for _ in range(200):
        z = random.normal(size=len(nominal))
        moved = {name: each.value + 0.3 * each.size * value for (name, each), value in zip(nominal.items(), z, strict=True)}
        assert np.all(np.roots(rational(num, den, moved)[1]).real < 0.0)
        unstable += np.any(np.roots(den * (1.0 + 0.3 * random.normal(size=len(den)))).real >= 0.0)
    assert unstable > 100


def test_a_moved_frequency_and_damping_of_a_state_space_are_its_poles():
    num, den = [2.0 * MODE[-1]], MODE
    plain = signal.tf2ss(num, den)
    stage = StateSpace(*plain)
    known = chain_coordinates([stage], ("x",))
    assert known["state_space.frequency[0]"].value == pytest.approx(900.0)
    assert known["state_space.damping[0]"].value == pytest.approx(0.05)
    assert known["state_space.gain[0][0]"].value == pytest.approx(2.0)
    (moved,) = with_coordinates(
        [stage], {"state_space.frequency[0]": 700.0, "state_space.damping[0]": 0.1, "state_space.gain[0][0]": 3.0}, ("x",)
    )
    again = chain_coordinates([moved], ("x",))
    assert again["state_space.frequency[0]"].value == pytest.approx(700.0)
    assert again["state_space.damping[0]"].value == pytest.approx(0.1)


def test_stages_of_one_name_are_counted():
    names = chain_coordinates([Delay(1e-4), TransferFunction([1.0], [1e-3, 1.0]), Delay([1e-5, 2e-5])], ("x", "y"))
    assert [name for name in names if "delay" in name] == ["delay.tau (x)", "delay.tau (y)", "delay(2).tau (x)", "delay(2).tau (y)"]
    first, _, second = with_coordinates(
        [Delay(1e-4), TransferFunction([1.0], [1e-3, 1.0]), Delay([1e-5, 2e-5])], {"delay(2).tau (y)": 3e-5}, ("x", "y")
    )
    assert first.tau == 1e-4 and second.tau == (1e-5, 3e-5)


@pytest.mark.parametrize("name", ["pea_hampi", "pea_hapi", "fsm_mhl", "fsm_cubespec"])
def test_the_same_numbers_make_the_same_model(name):
    model = load_model(config_path(f"models/{name}.yaml"))
    known = chain_coordinates(model.chain.stages, model.axes)
    again = model.with_stages(
        with_coordinates(model.chain.stages, {label: each.value for label, each in known.items()}, model.axes)
    )
    steps = np.random.default_rng(0).normal(size=(400, len(model.axes)))
    command = np.cumsum(0.05 * steps, axis=0) + 0.5 * np.mean(model.valid.get("command", [0.0, 2.0]))
    before, after = simulate(model, command), simulate(again, command)
    np.testing.assert_allclose(after, before, atol=1e-10 * np.abs(before).max())


def test_a_number_stays_within_its_bounds():
    (moved,) = with_coordinates([Delay(1e-4)], {"delay.tau": -1e-4}, ("x",))
    assert moved.tau == 0.0
