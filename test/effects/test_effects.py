# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What every effect of the catalogue promises: nothing where it is absent, its place in any chain, and a model file that holds it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Sampling
from hyst_control.chain.external_simulator import external_simulator
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.hysteresis.softening_modal import SofteningModal
from hyst_control.chain.linear.linear_stages import (
    CrossCoupling,
    Delay,
    RateCorrection,
    StateSpace,
    TransferFunction,
    linear_filter,
)
from hyst_control.chain.memoryless import Gain, Quantization
from hyst_control.chain.stage import STAGES
from hyst_control.effects import EFFECTS, insert
from hyst_control.effects.added_mass import AddedMass
from hyst_control.effects.backlash import Backlash
from hyst_control.effects.creep import Creep
from hyst_control.effects.effect import PLACES, Surroundings
from hyst_control.effects.hysteresis_rate import HysteresisRate
from hyst_control.effects.hysteresis_shape import HysteresisShape
from hyst_control.effects.hysteresis_width import HysteresisWidth
from hyst_control.effects.resonance import Resonance
from hyst_control.model_file import Model, load_model, save_model, simulate

ROOT = Path(__file__).resolve().parents[2]
DRIFT = {"change", "tau", "onset", "lasts"}
TABLE = {
    "creep": {"gamma", "begin", "decades"}, "gain": {"gain"}, "gain_drift": DRIFT, "offset": {"offset"}, "offset_drift": DRIFT,
    "hysteresis_width": {"width"}, "hysteresis_shape": {"amount"}, "hysteresis_rate": {"factor"}, "delay": {"tau"},
    "amplifier_lowpass": {"cutoff", "order"}, "sensor_lowpass": {"cutoff", "order"},
    "slew_limit": {"rate"}, "saturation": {"lower", "upper"},
    "dac_hold": {"samples", "step"}, "resonance": {"frequency", "damping", "gain"}, "added_mass": {"mass_ratio", "damping"},
    "backlash": {"half_width"}, "cross_coupling": {"coupling", "corner"}, "sensor_nonlinearity": {"second", "third"},
    "sensor_noise": {"rms"}, "flicker_noise": {"rms"}, "mains_hum": {"amplitude", "frequency"},
    "vibration": {"amplitude", "frequency"}, "softening_modes": {"softening", "damping"},
    "dry_friction": {"slack"}, "cubic_stiffness": {"loss"}, "clearance": {"half_width", "excess"}, "dead_zone": {"half_width", "center"},
    "output_saturation": {"lower", "upper"},
    "quantization": {"step"}, "held_samples": {"fraction"},
}  # fmt: skip
"""Names and parameters of the gap report."""

MODIFIERS = (
    "dry_friction",
    "cubic_stiffness",
    "clearance",
    "hysteresis_width",
    "hysteresis_shape",
    "hysteresis_rate",
    "added_mass",
    "softening_modes",
)


@cache
def model(kind: str) -> Model:
    """Shipped models, and one that is linear."""
    if kind != "linear":
        return load_model(ROOT / f"config/models/{kind}.yaml")
    stages = (Delay(2e-4), TransferFunction([4e6], [1.0, 400.0, 4e7]))
    return Model("linear", ("x",), {"command": "V", "measurement": "um"}, 1e-4, Chain(stages))


MODELS = ("pea_hampi", "fsm_mhl", "linear")


@cache
def command(kind: str) -> np.ndarray:
    axes = len(model(kind).axes)
    generator = np.random.default_rng(5)
    walk = np.cumsum(generator.standard_normal((400, axes)), axis=0)
    return 25.0 + 20.0 * walk / np.abs(walk).max()


@cache
def baseline(kind: str) -> np.ndarray:
    return simulate(model(kind), command(kind))


@cache
def around(kind: str) -> Surroundings:
    u, y, ts = command(kind), baseline(kind), model(kind).sample_time
    slew = float(np.abs(np.diff(u, axis=0)).max()) / ts
    return Surroundings(ts, len(u) * ts, (float(u.min()), float(u.max())), slew, (float(y.min()), float(y.max())), u.shape[1])


def fits(name: str, kind: str) -> bool:
    return not (EFFECTS[name].couples and kind != "fsm_mhl") and not (
        kind == "linear" and name in ("hysteresis_shape", "hysteresis_rate")
    )


CASES = [(name, kind) for name in EFFECTS for kind in MODELS if fits(name, kind)]


def with_effect(name: str, kind: str, values: dict) -> Model:
    effect = EFFECTS[name]
    return model(kind).with_stages(insert(model(kind).chain.stages, effect.place, effect.stage(values, around(kind))))


def present(name: str, kind: str) -> dict:
    """Values at which an effect is there: the middle start of every parameter, in the first of its variants."""
    starts = {p.name: p.starts[len(p.starts) // 2] for p in EFFECTS[name].parameters(around(kind))}
    return {**starts, **EFFECTS[name].variants(around(kind))[0]}


def test_the_catalogue_is_the_gap_reports():
    usual = around("fsm_mhl")
    told = {}
    for name, effect in EFFECTS.items():
        parameters = effect.parameters(usual)
        told[name] = {p.name for p in parameters if p.told} | set(effect.summary({p.name: p.starts[0] for p in parameters}))
    assert told == TABLE
    places = [PLACES.index(effect.place) for effect in EFFECTS.values()]
    assert places == sorted(places)
    assert set(EFFECTS) <= set(STAGES)


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("name", EFFECTS)
def test_starts_lie_within_bounds_and_are_not_absent(name, kind):
    for duration, sample_time in ((0.5, 1e-3), (0.5, 2e-5), (60.0, 1e-4)):
        record = Surroundings(sample_time, duration, (0.0, 50.0), 1e4, (0.0, 5.0), 2)
        parameters = EFFECTS[name].parameters(record)
        for p in parameters:
            assert p.starts and all(p.lower <= start <= p.upper for start in p.starts)
            assert p.lower < p.upper and p.scale > 0 and (not p.logarithmic or p.lower > 0)
        longest = max(len(p.starts) for p in parameters)
        for i in range(longest):
            assert any(p.starts[min(i, len(p.starts) - 1)] != p.absent for p in parameters)


@pytest.mark.parametrize("name, kind", CASES)
def test_an_absent_effect_changes_nothing(name, kind):
    absent = {p.name: p.absent for p in EFFECTS[name].parameters(around(kind))}
    found = simulate(with_effect(name, kind, absent), command(kind))
    np.testing.assert_allclose(found, baseline(kind), rtol=0, atol=1e-9 * np.ptp(baseline(kind)))


@pytest.mark.parametrize("name", [name for name in EFFECTS if not EFFECTS[name].couples])
def test_an_effect_on_one_axis_leaves_the_other_alone(name):
    kind = "fsm_mhl"
    parameters = EFFECTS[name].parameters(around(kind))
    values = {p.name: [present(name, kind)[p.name], p.absent] for p in parameters}
    found = simulate(with_effect(name, kind, values), command(kind)) - baseline(kind)
    size = 1e-9 * np.ptp(baseline(kind))
    assert np.abs(found[:, 0]).max() > 100 * size
    assert np.abs(found[:, 1]).max() < size


@pytest.mark.parametrize("name, kind", CASES)
def test_a_model_file_holds_an_effect(name, kind, tmp_path):
    """Also with values that are there on one axis only, infinite ones among them."""
    values = present(name, kind)
    if kind == "fsm_mhl":
        values = {p.name: [values[p.name], p.absent] for p in EFFECTS[name].parameters(around(kind))}
    written = with_effect(name, kind, values)
    save_model(written, tmp_path / "model.yaml")
    read = load_model(tmp_path / "model.yaml")
    assert read.chain.stages == written.chain.stages
    np.testing.assert_array_equal(simulate(read, command(kind)), simulate(written, command(kind)))


@pytest.mark.parametrize(
    "kind, place, index",
    [
        *(("pea_hampi", place, index) for place, index in zip(PLACES, (0, 0, 1, 1, 2, 2, 2, 2, 2), strict=True)),
        *(("fsm_mhl", place, index) for place, index in zip(PLACES, (0, 1, 2, 2, 3, 3, 3, 3, 3), strict=True)),
        *(("linear", place, index) for place, index in zip(PLACES, (0, 1, 1, 1, 2, 2, 2, 2, 2), strict=True)),
    ],
)
def test_a_stage_goes_to_its_place(kind, place, index):
    stage = Gain(2.0)
    found = insert(model(kind).chain.stages, place, stage)
    assert found[index] is stage
    assert (*found[:index], *found[index + 1 :]) == model(kind).chain.stages


@pytest.mark.parametrize("kind", MODELS)
def test_effects_stand_in_signal_order_however_they_came(kind):
    names = [name for name in EFFECTS if fits(name, kind) and name not in ("gain", "offset", "saturation")]
    places = {name: PLACES.index(EFFECTS[name].place) for name in names}
    for seed in range(10):
        stages = model(kind).chain.stages
        for name in np.random.default_rng(seed).permutation(names):
            stages = insert(stages, EFFECTS[name].place, EFFECTS[name].stage(present(name, kind), around(kind)))
        found = [places[stage.name] for stage in stages if stage.name in places and not (stage.name == "delay")]
        assert found == sorted(found)
        assert np.all(np.isfinite(simulate(model(kind).with_stages(stages), command(kind))))


def test_a_hysteresis_on_its_own_has_its_places():
    stages = (PrandtlIshlinskii([0.0, 5.0], [0.6, 0.4]),)
    assert [insert(stages, place, Gain(2.0)).index(Gain(2.0)) for place in PLACES] == [0, 0, 1, 1, 1, 1, 1, 1, 1]


def run(stages, u, ts=1e-4, hold="zoh"):
    sampling = Sampling(ts, u.shape[1], hold)
    running = Chain(tuple(stages)).filter(sampling)
    first = running.settle(u[0])
    output = running.process(u)
    return output if hold == "foh" else np.concatenate([first[None], output[:-1]])


def loop(amplitude=40.0, n=400):
    return 50.0 + amplitude * np.sin(2 * np.pi * np.arange(3 * n) / n)[:, None]


def test_width_minus_one_leaves_the_mean_curve_of_play_operators():
    u = loop()
    found = run([PrandtlIshlinskii([1.0, 9.0], [0.5, 0.3], 0.2), HysteresisWidth(-1.0)], u)
    np.testing.assert_allclose(found[1:], u[:-1], rtol=1e-12)


@pytest.mark.parametrize("dynamic", [{"k": -1e-3, "b": 0.02}, {"levels": [1e-3, 2e-3], "center": 10.0}])
def test_width_scales_the_area_of_a_loop(dynamic):
    hysteresis = ModifiedPrandtlIshlinskii([1.0, 9.0], [0.5, 0.3], **dynamic)
    u = loop()

    def area(stages):
        y = run(stages, u)
        return abs(np.trapezoid(y[601:1002, 0], u[600:1001, 0]))

    assert area([hysteresis, HysteresisWidth(0.25)]) == pytest.approx(1.25 * area([hysteresis]), rel=1e-9)


def test_rate_is_added_to_a_hysteresis_without_one():
    """A tenth of the slope for every unit of the factor comes late; what is slow does not change."""
    pair = [0.2, 0.5, 0.3], [-0.3, -0.2, 1.5]  # x³/5 + x²/2 + 3x/10 and its mirror image
    madelung, u = Madelung(*pair, 100.0, 2.0), np.concatenate([np.full((50, 1), 30.0), np.full((1000, 1), 60.0)])
    added = run([madelung, HysteresisRate(2.0)], u) - run([madelung], u)
    assert added[51, 0] == pytest.approx(-0.1 * 2.0 / 100.0 * 30.0 * np.exp(-0.1), rel=1e-9)
    assert abs(added[-1, 0]) < 1e-12


def test_bent_curve_is_zero_at_the_ends_and_the_amount_midway():
    hysteresis = PlayOperator(0.0)
    u = np.array([0.0, 25.0, 50.0, 50.0])[:, None]
    found = run([hysteresis, HysteresisShape(0.1, 0.0, 50.0)], u) - run([hysteresis], u)
    np.testing.assert_allclose(found[:, 0], [0.0, 0.0, 5.0, 0.0], atol=1e-12)


def test_creep_grows_with_the_logarithm_of_time():
    system = Creep(0.02).systems(1)[0]
    time = np.geomspace(0.5, 100.0, 20)
    rates = -np.diag(system.A)
    grown = np.array([np.sum(system.C[0] * (1.0 - np.exp(-rates * t))) for t in time])
    # A lag of time constant τ has come when log t is the logarithm of τ less Euler's constant, on the average.
    expected = 0.02 * (np.log10(time / 0.1) + np.euler_gamma / np.log(10.0))
    np.testing.assert_allclose(grown, expected, atol=0.02 * 0.08)
    np.testing.assert_allclose(grown[time < 40.0], expected[time < 40.0], atol=0.02 * 0.025)


@pytest.mark.parametrize("mass_ratio", [0.5, -0.3])
def test_added_mass_is_that_of_a_mass_on_a_spring(mass_ratio):
    mass, damping, stiffness = 2.0, 300.0, 8e6
    plain, heavier = (TransferFunction([stiffness], [m, damping, stiffness]) for m in (mass, mass * (1 + mass_ratio)))
    u = command("linear")
    np.testing.assert_allclose(run([plain, AddedMass(mass_ratio)], u), run([heavier], u), rtol=1e-9)


def test_added_mass_changes_one_axis_of_a_state_space():
    """Two oscillators as one block diagonal state space: each has its own mode."""
    w, z = np.array([2000.0, 3000.0]), 0.1
    a, b, c = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 4))
    for i in range(2):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, w[i]], [-w[i], -2 * z * w[i]]]
        b[2 * i + 1, i], c[i, 2 * i] = w[i], 1.0
    together = StateSpace(a.tolist(), b.tolist(), c.tolist(), np.zeros((2, 2)).tolist())
    ratio = np.array([0.3, -0.2])
    apart = TransferFunction((w**2)[:, None].tolist(), [[1 + r, 2 * z * v, v**2] for r, v in zip(ratio, w, strict=True)])
    u = command("fsm_mhl")
    np.testing.assert_allclose(run([together, AddedMass(ratio.tolist())], u), run([apart], u), rtol=1e-8)


def test_a_resonance_is_a_transfer_function_more():
    w = 2 * np.pi * 700.0
    base, mode = TransferFunction([6e6], [1.0, 300.0, 3e6]), TransferFunction([0.1 * 2.0 * w**2], [1.0, 0.04 * w, w**2])
    u = command("linear")
    found = run([base, Resonance(700.0, 0.02, 0.1)], u)
    np.testing.assert_allclose(found, run([Parallel(((base,), (mode,)))], u), rtol=1e-9)


def test_a_mode_of_all_axes_is_a_matrix_of_transfer_functions_more():
    """Asked for by name as the diagnosis does; entry [output][input] is what `in_phase_OUTPUT_INPUT` says."""
    w, random = 2 * np.pi * 700.0, np.random.default_rng(4)
    record = replace(around("fsm_mhl"), axes=2)
    values = {"frequency": 700.0, "damping": 0.02}
    values |= {p.name: random.normal() for p in EFFECTS["resonance"].coupled_parameters(record) if not p.told}
    size = record.stroke / (record.command[1] - record.command[0])
    base = TransferFunction([6e6], [1.0, 300.0, 3e6])
    mode = TransferFunction(
        [
            [[size * values[f"quadrature_{i}_{j}"] * w, size * values[f"in_phase_{i}_{j}"] * w**2] for j in range(2)]
            for i in range(2)
        ],
        [1.0, 0.04 * w, w**2],
        coupled=True,
    )
    u = command("fsm_mhl")
    found = run([base, EFFECTS["resonance"].stage(values, record)], u)
    np.testing.assert_allclose(found, run([Parallel(((base,), (mode,)))], u), rtol=1e-9, atol=1e-9 * np.abs(found).max())
    matrix = np.array([[values[f"in_phase_{i}_{j}"] + 1j * values[f"quadrature_{i}_{j}"] for j in range(2)] for i in range(2)])
    assert EFFECTS["resonance"].summary(values) == {
        "gain": pytest.approx(np.sqrt(np.linalg.eigvalsh(matrix.conj().T @ matrix)[-1]))
    }


def test_coupling_in_modes_is_a_matrix_of_transfer_functions_more():
    """Two modes, and two real poles as a mode of damping above 1; entry PART_MODE_OUTPUT_INPUT says what comes from where."""
    modes = ((700.0, 0.02), (300.0, 1.25))
    record = replace(around("fsm_mhl"), axes=2, modes=modes)
    parameters, random = EFFECTS["cross_coupling"].coupled_parameters(record), np.random.default_rng(4)
    assert len(parameters) == 2 * (2 * len(modes) + 1) and not any(p.told for p in parameters)
    values = {p.name: random.normal() for p in parameters}
    size = record.stroke / (record.command[1] - record.command[0])
    base = TransferFunction([6e6], [1.0, 300.0, 3e6])
    added = []
    for mode, (frequency, damping) in enumerate(modes):
        w = 2 * np.pi * frequency
        part = [[[0.0, 0.0, 0.0] for _ in range(2)] for _ in range(2)]
        for i, j in ((0, 1), (1, 0)):
            part[i][j] = [
                0.5 * size * values[f"static_{i}_{j}"],
                size * values[f"quadrature_{mode}_{i}_{j}"] * w + size * values[f"static_{i}_{j}"] * damping * w,
                size * values[f"in_phase_{mode}_{i}_{j}"] * w**2 + 0.5 * size * values[f"static_{i}_{j}"] * w**2,
            ]
        added.append(TransferFunction(part, [1.0, 2 * damping * w, w**2], coupled=True))
    u = command("fsm_mhl")
    found = run([base, EFFECTS["cross_coupling"].stage(values, record)], u)
    np.testing.assert_allclose(
        found, run([Parallel(((base,), *((one,) for one in added)))], u), rtol=1e-9, atol=1e-9 * np.abs(found).max()
    )
    at_rest = [
        [0.0 if i == j else values[f"static_{i}_{j}"] + sum(values[f"in_phase_{m}_{i}_{j}"] for m in range(2)) for j in range(2)]
        for i in range(2)
    ]
    assert EFFECTS["cross_coupling"].summary(values) == {"coupling": pytest.approx(np.linalg.norm(at_rest, 2))}


def test_play_is_half_as_wide_as_its_loop():
    u = np.concatenate([np.linspace(0, 10, 50), np.linspace(10, 0, 50), [0.0]])[:, None]
    found = run([Backlash(0.5)], u, hold="foh")
    np.testing.assert_allclose(found[10:50], u[10:50] - 0.5)
    np.testing.assert_allclose(found[60:100], u[60:100] + 0.5)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("stages", [[], [TransferFunction([1.0], [1e-5, 1.0])]])
def test_time_counts_from_the_start_of_the_record(hold, stages):
    """A drift and a line have their value of t_k in measurement k, whichever way the command is held."""
    u = np.full((100, 1), 2.0)
    time = np.arange(100) * 1e-4
    drift = EFFECTS["offset_drift"].stage({"change": 1.0, "tau": 3e-3}, around("linear"))
    line = EFFECTS["vibration"].stage({"amplitude": 0.5, "frequency": 130.0, "phase": 0.4}, around("linear"))
    found = run([*stages, drift, line], u, hold=hold)[:, 0]
    np.testing.assert_allclose(found, 3.0 - np.exp(-time / 3e-3) + 0.5 * np.sin(2 * np.pi * 130.0 * time + 0.4), rtol=1e-12)


def test_noises_have_their_rms_and_colour():
    u = np.zeros((200_000, 1))
    white = run([EFFECTS["sensor_noise"].stage({"rms": 0.3}, around("linear"))], u)[:, 0]
    pink = run([EFFECTS["flicker_noise"].stage({"rms": 0.3}, around("linear"))], u)[:, 0]
    assert white.std() == pytest.approx(0.3, rel=0.02)
    assert np.sqrt(np.mean(pink**2)) == pytest.approx(0.3, rel=0.3)  # a fifth of its power is below the record's 0.05 Hz
    for noise, slope in ((white, 0.0), (pink, -1.0)):
        frequency, density = welch(noise, 1e4, nperseg=20_000)
        band = (frequency > 3.0) & (frequency < 500.0)
        assert np.polyfit(np.log(frequency[band]), np.log(density[band]), 1)[0] == pytest.approx(slope, abs=0.15)


def test_another_seed_is_another_noise():
    u = np.zeros((100, 1))
    first, second = (run([EFFECTS["sensor_noise"].stage({"rms": 1.0, "seed": seed}, around("linear"))], u) for seed in (1, 2))
    assert not np.any(first == second)


def test_a_fraction_of_the_samples_repeats():
    u = np.arange(20_000.0)[:, None]
    found = run([EFFECTS["held_samples"].stage({"fraction": 0.2}, around("linear"))], u, hold="foh")
    assert np.mean(np.diff(found[:, 0]) == 0.0) == pytest.approx(0.2, abs=0.01)
    assert np.all(np.isin(found, u))


def test_coupling_comes_through_its_own_corner():
    stage = EFFECTS["cross_coupling"].stage({"coupling": [0.1, 0.0], "corner": [200.0, 900.0]}, around("fsm_mhl"))
    assert isinstance(stage, CrossCoupling)
    u = np.zeros((100, 2))
    u[1:, 1] = 1.0
    found = run([stage], u, ts=1e-4)
    time = np.maximum(np.arange(100) - 1, 0) * 1e-4
    np.testing.assert_allclose(found[:, 0], 0.1 * (1.0 - np.exp(-2 * np.pi * 200.0 * time)), atol=1e-12)


@pytest.mark.parametrize("stage", [HysteresisRate(2.0), HysteresisShape(0.1, 0.0, 1.0), AddedMass(0.1)])
def test_what_changes_nothing_is_refused(stage):
    with pytest.raises(InputError, match=stage.name):
        Chain((Gain(2.0), stage)).filter(Sampling(1e-4, 1))


def test_a_model_file_with_nothing_to_change_is_refused(tmp_path):
    written = model("linear").with_stages((*model("linear").chain.stages, HysteresisRate(2.0)))
    save_model(written, tmp_path / "model.yaml")
    with pytest.raises(InputError, match="hysteresis_rate"):
        load_model(tmp_path / "model.yaml")


def test_a_chain_without_hysteresis_gets_a_loop_of_the_stated_width():
    u = 50.0 - 50.0 * np.cos(2 * np.pi * np.arange(4001) / 2000)[:, None]
    y = run([HysteresisWidth(0.1, 100.0, 50.0)], u, hold="foh")[:, 0]
    assert y[3500] - y[2500] == pytest.approx(0.1 * 100.0)  # falling over rising, at the middle of the span
    forth_and_back = y[2000:] + y[2000:][::-1]
    assert forth_and_back[500] == pytest.approx(2 * u[2500, 0])  # about the same mean curve
    np.testing.assert_allclose(y[[2000, 3000, 4000]], [0.0, 100.0, 0.0], atol=1e-9)  # between the same ends


def test_mass_without_a_mode_is_refused():
    with pytest.raises(InputError, match="two poles"):
        Chain((TransferFunction([1.0], [1e-3, 1.0]), AddedMass(0.1))).filter(Sampling(1e-4, 1))


def test_modifiers_reach_into_branches():
    """The lag beside a Madelung hysteresis is its rate part."""
    pair = [0.2, 0.5, 0.3], [-0.3, -0.2, 1.5]
    madelung, u = Madelung(*pair, 100.0, 2.0), loop()

    def plant(k1):
        return Parallel(((madelung,), (RateCorrection(k1, 7e-4),)))

    np.testing.assert_allclose(run([plant(-1e-5), HysteresisRate(3.0)], u), run([plant(-3e-5)], u), rtol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_a_lag_before_what_is_linear_in_disguise_is_exact(order):
    """A play of threshold 0 is no hysteresis, but the chain does not know: it must come out as the lag before the mechanics."""
    lag = STAGES["amplifier_lowpass"](900.0, order)
    mechanics, u = TransferFunction([4e6], [1.0, 400.0, 4e7]), command("linear")
    exact, found = (run([Delay(1.3e-4), lag, *play, mechanics], u) for play in ([], [PlayOperator(0.0)]))
    assert np.abs(found - exact).max() < (1e-9, 0.02)[order - 1] * np.ptp(exact)


def test_rounding_stands_behind_noise_and_before_transport():
    stages = insert((Gain(1.0),), "adc", Quantization(0.1))
    stages = insert(stages, "transport", EFFECTS["held_samples"].stage({"fraction": 0.1}, around("linear")))
    stages = insert(stages, "sensor", Gain(1.1))
    assert [stage.name for stage in stages] == ["gain", "gain", "quantization", "held_samples"]


def test_the_mean_of_a_lag_over_an_interval():
    """After a step, 1 - (τ / T) (1 - exp(-T / τ)) exp(-k T / τ) in interval k; here 0.3 T late, in closed form from the integral."""
    ts, tau, late = 1e-4, 7e-5, 0.3e-4
    running = linear_filter([Delay(late), STAGES["amplifier_lowpass"](1 / (2 * np.pi * tau))], Sampling(ts, 1), averaged=True)
    running.settle(np.zeros(1))
    found = running.process(np.ones((6, 1)))[:, 0]
    edges = np.maximum(np.arange(7) * ts - late, 0.0)
    integral = edges - tau * (1.0 - np.exp(-edges / tau))
    np.testing.assert_allclose(found, np.diff(integral) / ts, rtol=1e-12)
    assert running.hold == "zoh"


def test_a_stage_with_dynamics_of_its_own_sees_no_lag_of_infinite_cutoff():
    structure = SofteningModal(
        decay=[5.0], frequency=[2e3], outputs=[[[0.3]], [[0.1]]], inputs=[[[100.0]], [[0.0]]], feedthrough=[[0.1]], amplitude=50.0
    )
    stages, u = (structure, TransferFunction([4e6], [1.0, 400.0, 4e7])), command("linear")
    lag = STAGES["amplifier_lowpass"](np.inf)
    assert insert(stages, "drive", lag)[0] is lag
    np.testing.assert_allclose(run([lag, *stages], u), run(stages, u), rtol=0, atol=1e-12)


def test_hysteresis_that_cannot_be_changed_within_gets_more_of_it_before():
    """As of a Python function: its loops are those of the command that it is given."""

    def doubled(command, sample_time):
        return 2.0 * command

    function, u = external_simulator(doubled, {})[0], command("linear")
    wider = HysteresisWidth(0.1, span=100.0, centre=50.0)
    moved = run([wider, function], u)
    np.testing.assert_array_equal(run([function, wider], u), moved)
    assert np.ptp(moved - run([function], u)) > 1.0
