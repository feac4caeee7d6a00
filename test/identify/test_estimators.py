# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Promises of every estimator, held by each of them alike: a family that is added needs an example here, and no test of its own for these.

Truth is a chain of the family's own stages; only the noise and the records' commands are not the estimator's.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Stage
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, RateCorrection, TransferFunction
from hyst_control.chain.memoryless import Offset
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.identify import Fit, estimator_of, estimators, identify
from hyst_control.identify.families.estimator import described, every_option
from hyst_control.model_file import Model, load_model, save_model, simulate
from hyst_control.records.record import Record, sampled_record
from hysteretic_oscillators.stages.bouc_wen import BoucWen
from hysteretic_oscillators.stages.duhem import Duhem
from hysteretic_oscillators.stages.duhem_oscillator import DuhemOscillator

pytestmark = pytest.mark.long_file

REPEATS, FEW = 12, 8
"""Fits under noise of their own; of families whose fit takes seconds."""
THRESHOLDS, WEIGHTS = (0.0, 3.0, 7.0, 12.0), (0.055, 0.012, 0.010, 0.008)


@dataclass(frozen=True)
class Example:
    """A known plant of a family, how it was excited, and what must be found again.

    `parameters`: rows of the report with the truth; `scatter`: those whose standard errors are held against so many `repeats`.
    """

    stages: tuple[Stage, ...]
    command: np.ndarray
    sample_time: float
    parameters: Mapping[str, float]
    options: Mapping[str, object] = field(default_factory=dict)
    noise: float = 0.002
    scatter: tuple[str, ...] = ()
    repeats: int = REPEATS

    @property
    def plant(self) -> Model:
        return Model("plant", ("x",), {"command": "V", "measurement": "um"}, self.sample_time, Chain(self.stages))

    def record(self, seed: int | None, command: np.ndarray | None = None) -> Record:
        """A record of the plant; without a seed without noise."""
        command = self.command if command is None else command
        clean = simulate(self.plant, command)
        noise = 0.0 if seed is None else self.noise * np.random.default_rng(seed).normal(size=clean.shape)
        return sampled_record("loops", command, clean + noise, self.sample_time, ("x",), "um", start="settled")


def loops(sample_time: float, *cycles: tuple[float, float], seconds: float = 0.1) -> np.ndarray:
    """Loops (N, 1) from 0 V and back, each of a frequency in Hz and a peak in V, for about `seconds`, a rest behind each."""
    parts = []
    for frequency, peak in cycles:
        count = max(round(frequency * seconds), 1)
        phase = 2 * np.pi * np.arange(round(count / frequency / sample_time)) * frequency * sample_time
        parts += [0.5 * peak * (1 - np.cos(phase)), np.zeros(round(0.01 / sample_time))]
    return np.concatenate(parts)[:, None]


W = 2 * np.pi * 700.0
MODE = TransferFunction([W * W], [1.0, 0.6 * W, W * W])
SLOW = loops(1e-3, (1.0, 50.0), (2.0, 35.0), (2.0, 45.0), (4.0, 20.0), (4.0, 50.0))
FAST = loops(1e-4, (5.0, 50.0), (40.0, 50.0), (150.0, 40.0), (400.0, 45.0), (80.0, 25.0), (20.0, 35.0))
BRIEF = loops(1e-4, (20.0, 50.0), (40.0, 50.0), (150.0, 40.0), (400.0, 45.0), (80.0, 25.0), (20.0, 35.0), seconds=0.03)
"""For differential equations, which are integrated sample by sample: every amplitude and rate of `FAST`, fewer loops."""
CURVES = Madelung([0.2, 0.5, 0.3], [-0.3, -0.2, 1.5], 50.0, 2.0)
WEIGHT_ROWS = {f"weights[{i}]": weight for i, weight in enumerate(WEIGHTS)}
GIVEN = {"thresholds": THRESHOLDS, "nuisance": "none"}
MECHANICS = {"num[0]": W * W, "den[1]": 0.6 * W, "den[2]": W * W}

EXAMPLES = {
    "pi": Example(
        (PrandtlIshlinskii(THRESHOLDS[1:], WEIGHTS[1:], w0=WEIGHTS[0]),), SLOW, 1e-3, WEIGHT_ROWS, GIVEN, scatter=tuple(WEIGHT_ROWS)
    ),
    "hapi": Example(
        (PrandtlIshlinskii(THRESHOLDS[1:], WEIGHTS[1:], w0=WEIGHTS[0]), Delay(1.3e-4), MODE),
        FAST,
        1e-4,
        {**WEIGHT_ROWS, "tau": 1.3e-4, **MECHANICS},
        {**GIVEN, "structure": "modes=1,delay"},
        scatter=(*WEIGHT_ROWS, "tau", "den[1]"),
    ),
    "rdpi": Example(
        (RateDependentPrandtlIshlinskii(THRESHOLDS, WEIGHTS, beta=2e-4),),
        FAST,
        1e-4,
        {**WEIGHT_ROWS, "beta": 2e-4},
        GIVEN,
        scatter=tuple(WEIGHT_ROWS),
    ),
    "hampi": Example(
        (ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS, m1=2e-7, m2=1e-7, k=-4e-5, b=0.001), Delay(1.3e-4), MODE),
        FAST,
        1e-4,
        {**WEIGHT_ROWS, "m1": 2e-7, "m2": 1e-7, "k": -4e-5, "tau": 1.3e-4, **MECHANICS},
        {**GIVEN, "structure": "modes=1,delay"},
        scatter=(*WEIGHT_ROWS, "m1", "m2", "k", "tau", "den[1]"),
    ),
    "madelung": Example(
        (CURVES, Offset(0.4)),
        SLOW,
        1e-3,
        {f"{name}[{i}]": value for name in ("ascending", "descending") for i, value in enumerate(getattr(CURVES, name))},
        {"degree": 3},
        scatter=tuple(f"{name}[{i}]" for name in ("ascending", "descending") for i in range(3)),
    ),
    "mhl": Example(
        (Delay(1.3e-4), Parallel(((CURVES,), (RateCorrection(k1=-2e-5, k2=1e-3),))), MODE),
        FAST,
        1e-4,
        {"output_scale": 2.0, "k1": -2e-5, "k2": 1e-3, "tau": 1.3e-4, **MECHANICS},
        {"degree": 3, "structure": "modes=1,delay", "nuisance": "offset"},
        scatter=("output_scale", "k1", "k2", "tau", "den[1]"),
        repeats=FEW,
    ),
    "bouc_wen": Example(
        (BoucWen(10.0 / W**2, 6.0 / W, 6.0, 4.0, 0.5, -0.2),),
        BRIEF,
        1e-4,
        {"mass": 10.0 / W**2, "damping": 6.0 / W, "stiffness": 6.0, "alpha": 4.0, "beta": 0.5, "gamma": -0.2},
        {"exponent": 1.0},
        scatter=("mass", "damping", "stiffness", "alpha", "beta", "gamma"),
        repeats=FEW,
    ),
    "duhem_oscillator": Example(
        (DuhemOscillator(10.0 / W**2, 6.0 / W, 6.0, [-3.0, 0.0, 3.0], [4.5, 4.0, 2.5], [2.5, 4.0, 4.5]),),
        BRIEF,
        1e-4,
        {"mass": 10.0 / W**2, "damping": 6.0 / W, "stiffness": 6.0, "rising[1]": 4.0, "falling[1]": 4.0},
        {"table_size": 3},  # no scatter: its standard errors are those of `bouc_wen`, by the same code, and fits take longest
    ),
    "duhem": Example(
        (Delay(1.3e-4), Duhem(0.1, -0.03, 0.03, -0.008, 1.3, 4e-3), MODE),
        BRIEF,
        1e-4,
        {"slope": 0.1, "alpha": -0.03, "beta": 0.03, "gamma": -0.008, "exponent": 1.3, "growth": 4e-3, "tau": 1.3e-4, **MECHANICS},
        {"structure": "modes=1,delay", "creep": False, "nuisance": "offset"},
        scatter=("slope", "alpha", "tau", "den[1]"),
        repeats=FEW,
    ),
    "linear": Example(
        (Delay(2e-4), TransferFunction([0.05 * W * W], [1.0, 0.1 * W, W * W])),
        FAST,
        1e-4,
        {"frequency[0]": 700.0, "damping[0]": 0.05},
        {"order": 2, "delay": 2e-4, "direct": False},
        scatter=("frequency[0]", "damping[0]"),
    ),
}
FAMILIES = sorted(EXAMPLES)


def values(fit: Fit, key: str = "value") -> dict[str, float]:
    return {row["name"]: row[key] for row in fit.report["parameters"]}


def one_line(error: InputError) -> bool:
    return "\n" not in str(error) and 10 < len(str(error)) < 300


@pytest.fixture(scope="module")
def fits() -> dict[str, Fit]:
    """Every family identified from its own plant without noise."""
    return {name: identify([each.record(None)], name, **each.options) for name, each in EXAMPLES.items()}


def test_every_family_has_an_example():
    assert set(FAMILIES) == set(estimators())


@pytest.mark.parametrize("name", FAMILIES)
def test_a_known_model_is_found_again(name, fits):
    example, found = EXAMPLES[name], values(fits[name])
    wrong = {
        key: (found.get(key), true) for key, true in example.parameters.items() if found.get(key) != pytest.approx(true, rel=2e-3)
    }
    assert not wrong


@pytest.mark.parametrize("name", FAMILIES)
def test_another_command_is_predicted(name, fits):
    """Loops of other amplitudes and rates, of which no sample was fitted, within the noise of the sensor: 0.1 % of range."""
    example = EXAMPLES[name]
    top = 0.1 / (example.sample_time * 1e3)
    fresh = example.record(None, loops(example.sample_time, (3.0, 48.0), (30.0 * top, 30.0), (7.0, 40.0), (250.0 * top, 44.0)))
    error = simulate(fits[name].model, fresh.command) - fresh.measurement
    assert np.sqrt(np.mean(error**2)) < 1e-3 * np.ptp(fresh.measurement)


@pytest.mark.parametrize("name", [name for name in FAMILIES if EXAMPLES[name].scatter])
def test_standard_errors_are_the_scatter_of_repeated_noise(name):
    """The same record under noise of its own each time: a standard deviation from 12 fits is good to a fifth, from 8 to a quarter."""
    example = EXAMPLES[name]
    repeated = [identify([example.record(seed)], name, **example.options) for seed in range(example.repeats)]
    for key in example.scatter:
        scatter = np.std([values(fit)[key] for fit in repeated], ddof=1)
        reported = np.sqrt(np.mean([values(fit, "standard_error")[key] ** 2 for fit in repeated]))
        assert 0.5 < reported / scatter < 2.0, (key, reported, scatter)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize(
    "change, words",
    [
        (lambda data: data.rows(0, 10), "samples, got 10: record for longer"),
        (lambda data: data.with_values(command=np.full_like(data.command, 3.0)), "command of axis x never moves"),
        (lambda data: data.with_values(measurement=np.full_like(data.measurement, 3.0)), "measurement of axis x never moves"),
        (lambda data: data.with_values(measurement=np.where(data.command > 40.0, np.nan, data.measurement)), "must be finite"),
    ],
    ids=["short", "constant command", "constant measurement", "not finite"],
)
def test_records_that_tell_nothing_are_refused_in_one_line(name, change, words):
    example = EXAMPLES[name]
    with pytest.raises(InputError, match=words) as caught:
        identify([change(example.record(0))], name, **example.options)
    assert one_line(caught.value) and "loops" in str(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_no_record_and_records_of_two_plants_are_refused(name):
    data = EXAMPLES[name].record(0)
    other = {topic: replace(each, axes=("y",)) for topic, each in data.signals.items()}
    turned = {**data.signals, "measurement": replace(data.signals["measurement"], unit="mrad")}
    for records in ([], [data, replace(data, signals=other)], [data, replace(data, signals=turned)]):
        with pytest.raises(InputError) as caught:
            identify(records, name)
        assert one_line(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_options_that_the_family_does_not_have_are_refused(name):
    """`operators`, `thresholds` and `one_sided` were dropped without a word by families that have none."""
    foreign = [other for other in every_option() if not estimator_of(name).has([other])] + ["nonsense"]
    for other in foreign:
        with pytest.raises(InputError, match=f"{other}: {name} has no such option: it has method") as caught:
            identify([EXAMPLES[name].record(0)], name, **{other: True})
        assert one_line(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_options_are_data(name):
    """Each says what it is; its default is among its values, and is the same as a text; what is out of range is refused."""
    for option in estimator_of(name).declared:
        assert len(option.meaning) > 10 and option.name in described({name: option}) + option.name
        assert option.checked(option.default) == option.default
        if option.default is not None:
            assert option.checked(str(option.default)) == option.default
        wrong = ["certainly no such value"]
        wrong += [option.lower - 1] if option.lower is not None else []
        wrong += [option.upper + 1] if option.upper is not None else []
        for value in wrong:
            with pytest.raises(InputError, match=f"^{name}: {option.name}: must be ") as caught:
                estimator_of(name).options(**{option.name: value})
            assert one_line(caught.value)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_method_that_the_family_does_not_have_is_refused(name):
    with pytest.raises(InputError, match=f"{name}: method: must be .*joint"):
        identify([EXAMPLES[name].record(0)], name, "newest")
    assert estimator_of(name).methods[0] == "joint"


@pytest.mark.parametrize("name", FAMILIES)
def test_the_report_has_one_form(name, fits, tmp_path):
    fit, example = fits[name], EXAMPLES[name]
    report = json.loads(json.dumps(fit.report, allow_nan=False))
    assert (report["family"], report["method"], report["unit"]) == (name, "joint", "um")
    assert [row["name"] for row in report["records"]] == ["loops"]
    assert set(report["records"][0]) >= {"axis", "samples", "rmse", "nrmse", "nrmse_centered", "nme", "unit", "whiteness"}
    for row in report["parameters"]:
        assert set(row) >= {"name", "value", "standard_error", "unit", "axis"}
        assert row["axis"] == "x" and np.isfinite(row["value"])
        assert row["standard_error"] is None or row["standard_error"] >= 0
    assert all(isinstance(note, str) for note in report["notes"])
    assert not estimator_of(name).suggested or len(report["held_out_nrmse"]) == 1
    save_model(fit.model, tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml") == fit.model
    assert fit.model.axes == ("x",) and fit.model.units["measurement"] == "um"
    assert fit.model.sample_time == example.sample_time and fit.model.valid["command"][1] == pytest.approx(50.0, rel=0.1)
    assert fit.model.tolerance and all(value >= 0 for value in fit.model.tolerance.values())


@pytest.mark.parametrize("name", FAMILIES)
def test_the_uncertainty_is_of_physical_size_and_makes_models(name, fits):
    """No number is less known than to 30 %, and what the covariance draws runs and stays near the identified model."""
    model, example = fits[name].model, EXAMPLES[name]
    known = chain_coordinates(model.chain.stages, model.axes)
    factor = np.array(model.uncertainty["factor"])
    names = model.uncertainty["parameters"]
    assert factor.shape == (len(names), len(names))
    sizes = np.array([known[number].size for number in names])
    assert np.all(np.linalg.norm(factor, axis=1) <= 0.3 * sizes * (1.0 + 1e-6) + 1e-12)
    assert all(value <= 0.3 for value in model.tolerance.values())
    command = example.record(0).command
    nominal = simulate(model, command)
    scatter = scatter_of(model)
    for seed in range(5):
        drawn = scatter.at(np.random.default_rng(seed).normal(size=len(scatter.coefficients)))
        change = simulate(model.with_stages(drawn), command) - nominal
        # Of a family that fits its plant to the last bit the covariance is rounding, which may move the output or not.
        exact = np.linalg.norm(factor) < 1e-9 * np.linalg.norm(sizes)
        assert (exact or 0.0 < np.std(change)) and np.std(change) < 0.05 * np.ptp(nominal)
