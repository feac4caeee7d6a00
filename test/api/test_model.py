# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Models of the front door: scores computed by hand, an inverse for every model, a linear system, and a record that is none."""

from __future__ import annotations

import webbrowser

import numpy as np
import pytest
from matplotlib import pyplot
from scipy.signal import StateSpace, dlsim

import hyst_control as hc
from hyst_control.api.shown import promoted
from hyst_control.base.config_files import config_path
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import CrossCoupling, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.identify import identify
from hyst_control.model_file import Model, simulate

RATE = 1000.0
TIME = np.arange(3000) / RATE
COMMAND = 30 - 25 * np.cos(2 * np.pi * 4 * TIME) * np.cos(2 * np.pi * 0.5 * TIME)


def model(*stages, axes=("x",)):
    units = {"command": "V", "measurement": "um"}
    return promoted(hc.Model, Model("stage", axes, units, 1 / RATE, Chain(stages), valid={"command": [0.0, 60.0]}))


LAG = TransferFunction([0.1], [2e-3, 1.0])


def test_a_score_is_what_it_says():
    stage = model(LAG)
    record = stage.simulate(COMMAND)
    error = 0.05 * np.random.default_rng(0).standard_normal(len(COMMAND))
    measured = record.signal("measurement").values[:, 0] + error
    score = stage.score(hc.from_arrays(COMMAND, measured, RATE))
    assert score.nrmse == pytest.approx(
        100 * np.sqrt(np.mean(error**2)) / np.ptp(measured), rel=0.03
    )  # the first rows fill the memory
    assert float(score) == score.r2 == pytest.approx(1 - np.mean(error**2) / np.var(measured), rel=1e-4)
    assert "nrmse" in str(score) and "R2 0.99" in score._repr_html_()


def test_noise_is_drawn_by_its_seed():
    stage = promoted(
        hc.Model, Model("stage", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain((LAG,)), noise={"sigma": 0.1})
    )
    silent, first, again, other = (stage.simulate(COMMAND, seed=seed).signal("measurement").values for seed in (None, 1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.std(first - silent) == pytest.approx(0.1, rel=0.1) and not np.array_equal(first, other)


@pytest.mark.parametrize("seed", [-1, 1.5, "one"])
def test_a_seed_that_is_none_is_refused(seed):
    stage = model(LAG)
    with pytest.raises(hc.InputError, match="seed: must be an integer >= 0"):
        stage.simulate(COMMAND, seed=seed)
    with pytest.raises(hc.InputError, match="seed: must be an integer >= 0"):
        hc.diagnose(stage.simulate(COMMAND), stage, seed=seed, verbose=False)


@pytest.mark.parametrize("delay", [-3, 0.5, 10**6, np.nan])
def test_a_loop_delay_that_is_none_is_named(delay):
    with pytest.raises(hc.InputError, match=f"loop_delay: must be an integer from 0 to 1000 ticks, got {delay}"):
        hc.tune(model(LAG), loop_delay=delay)


@pytest.mark.parametrize("rate", [0, -5, np.inf, np.nan, "1000"])
@pytest.mark.parametrize("call", [lambda stage, rate: stage.simulate(COMMAND, rate), hc.Model.inverse, hc.Model.linear, hc.tune])
def test_a_rate_that_is_none_is_named(call, rate):
    with pytest.raises(hc.InputError, match="rate: must be a (finite )?number > 0 Hz"):
        call(model(LAG), rate)


def test_numbers_of_numpy_are_numbers():
    first, *others = (hc.tune(model(LAG), roll_off=kind(300)).ki for kind in (float, np.int64, np.float32))
    assert others == [first, first]


def test_integral_action_leaves_no_error_at_rest(recwarn):
    stage = model(LAG)
    sensitivity = hc.tune(stage).sensitivity(stage, [0.0, 1.0])
    assert sensitivity[0] == 0.0 < sensitivity[1] < 1.0 and not recwarn


def test_axes_of_other_names_are_matched_in_their_order():
    stage = model(LAG, axes=("a", "b"))
    simulated = stage.simulate(np.c_[COMMAND, COMMAND[::-1]])
    record = hc.from_arrays(simulated.command, simulated.measurement, RATE)
    score = stage.score(record)
    assert score.nrmse < 1e-6 and "its axes x, y are taken for the axes a, b of stage, in this order" in score.summary()
    assert len(stage.plot(record)) == 8 and stage.bode(record)
    turned = hc.from_arrays(simulated.command, simulated.measurement, RATE, axes=["b", "a"])
    with pytest.raises(
        hc.InputError, match="has the axes a, b, the record arrays b, a: import the record with its axes in that order"
    ):
        stage.score(turned)
    pyplot.close("all")


@pytest.mark.parametrize("rate", [None, 400.0])
def test_a_linear_model_is_its_linear_system(rate):
    stage = model(LAG, Gain(0.5))
    system = stage.linear(rate)
    assert isinstance(system, StateSpace) and system.dt == pytest.approx(1 / (rate or RATE))
    _, found, _ = dlsim(system, COMMAND - COMMAND[0])
    rows = stage.simulate(COMMAND, rate).signal("measurement").values
    np.testing.assert_allclose(found, rows - rows[0], atol=1e-9)


@pytest.mark.parametrize("frequency", [10.0, 300.0])
def test_the_inverse_of_a_mirror_has_its_dynamics(frequency):
    """About the angles that a command of 40 V amplitude reaches at this frequency."""
    mirror = hc.load_model(config_path("models/fsm_mhl.yaml"))
    time = np.arange(8000) * mirror.sample_time
    command = 50.0 + 40.0 * np.minimum(time / 0.05, 1.0) * np.sin(2 * np.pi * frequency * time)
    reference = mirror.simulate(np.repeat(command[:, None], 2, axis=1)).signal("measurement").values
    inverse = mirror.inverse(limits=(-20.0, 120.0))
    error = mirror.simulate(inverse(reference)).signal("measurement").values - reference
    ahead = inverse.compensator.preview
    assert np.sqrt(np.mean(error[2000 : len(error) - ahead] ** 2)) < 0.01 * np.std(reference)


def test_an_inverse_that_leaves_out_parts_of_the_model_says_which_and_why(caplog):
    """The mirror's curves have an inverse of each axis, its coupling has not; the whole inverse of the mirror alone leaves out nothing."""
    mirror = hc.load_model("fsm_mhl")
    assert mirror.inverse().left_out == "" and "leaves out" not in str(mirror.inverse()) and not caplog.records
    coupled = promoted(hc.Model, mirror.with_stages([*mirror.chain.stages, CrossCoupling([[1.0, 0.1], [0.1, 1.0]])]))
    inverse = coupled.inverse()
    assert "leaves out the dynamics, the delay, the cross-coupling (mhl_inverse: chain (cross_coupling)" in str(inverse)
    assert len(caplog.records) == 1 and inverse.left_out in caplog.text


@pytest.mark.parametrize(("amplitude", "lines"), [(0.5, 0), (20.0, 1)])
def test_an_inverse_at_its_limits_warns_once(amplitude, lines, caplog):
    stage = hc.load_model("pea_hampi")
    reference = 2.0 + amplitude * (1.0 - np.cos(2 * np.pi * 50 * np.arange(2000) * stage.sample_time))
    command = stage.inverse()(reference)
    assert [each.levelname for each in caplog.records] == ["WARNING"] * lines
    assert all(f"limits in {np.count_nonzero(command == 50.0)} of 2000 samples" in each.getMessage() for each in caplog.records)


def test_what_has_no_compensator_is_inverted_over_the_whole_reference():
    stage = hc.load_model("fsm_cubespec")
    inverse = stage.inverse()
    assert inverse.compensator is None
    rate = 1 / stage.sample_time
    lower, upper = np.array(stage.valid["command"], dtype=float).reshape(-1, 2)[0]
    middle, reach = (
        stage.simulate(np.full((50, len(stage.axes)), v)).signal("measurement").values[-1] for v in ((lower + upper) / 2, upper)
    )
    phase = 2 * np.pi * 5 * np.arange(2000) / rate
    reference = middle + 0.2 * (reach - middle) * (1 - np.cos(phase))[:, None]
    error = stage.simulate(inverse(reference)).signal("measurement").values - reference
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.abs(reach - middle).max()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda stage: stage.simulate(np.zeros((9, 2))), "command: has 2 columns, the model 1 axes"),
        (lambda stage: stage.inverse()(np.zeros((9, 2))), "reference: has 2 columns"),
        (lambda stage: stage.simulate([0.0, np.nan]), "command: row 1 holds no finite number"),
        (lambda stage: stage.inverse()([np.inf, 0.0]), "reference: row 0 holds no finite number"),
        *(
            (
                lambda stage, limits=limits: stage.inverse(limits=limits),
                "limits: must be lower and upper, each a number or one for each of x",
            )
            for limits in (([0, 0], [1, 1]), (0, 1, 2), 5)
        ),
        (
            lambda stage: hc.identify(stage.simulate(COMMAND), "pi", start="x"),
            "start: must be one of settled, unknown, auto, got 'x'",
        ),
        (
            lambda stage: stage.score(hc.from_arrays(np.c_[COMMAND, COMMAND], np.c_[COMMAND, COMMAND], RATE)),
            "has the axes x, the record arrays x, y: use a model of this plant",
        ),
        (
            lambda stage: stage.score(hc.from_arrays(COMMAND, COMMAND, RATE, unit="mrad")),
            "is in um of V, the record arrays in mrad of V",
        ),
        (lambda stage: hc.load_model("no_such_model"), "pea_hampi.yaml"),
        (lambda stage: stage.bode(hc.from_arrays(COMMAND, COMMAND, RATE, unit="mrad")), "use a model of this plant"),
        (lambda stage: hc.identify(hc.from_arrays(COMMAND, np.random.default_rng(0).standard_normal(3000), RATE)), "noise"),
        (
            lambda stage: hc.identify(hc.from_arrays(np.tile(COMMAND, (2, 1)), np.tile(COMMAND, (2, 1)), RATE)),
            "transpose the arrays",
        ),
    ],
)
def test_what_does_not_fit_is_one_line(call, words):
    with pytest.raises(hc.InputError, match=words) as raised:
        call(model(LAG))
    assert "\n" not in str(raised.value)


def test_a_model_comes_back_from_its_file(tmp_path):
    stage = model(LAG)
    stage.save(tmp_path / "stage.yaml")
    again = hc.load_model(tmp_path / "stage.yaml")
    assert again == stage and "transfer_function" in str(again) and "0 to 60 V" in again.summary()


def test_a_record_that_is_no_measurement_has_a_page_that_says_so(monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    noise = np.random.default_rng(1).standard_normal(3000)
    gap = hc.diagnose(hc.from_arrays(COMMAND, noise, RATE), model(LAG))
    assert gap.verdict == "unknown" and gap.model is None and "no measurement of its command" in str(gap)
    path = gap.show()
    assert opened == [path.as_uri()] and "noise" in path.read_text(encoding="utf-8")


def test_several_axes_are_drawn_one_by_one():
    pyplot.switch_backend("Agg")
    stage = model(LAG, axes=("x", "y"))
    record = stage.simulate(np.column_stack([COMMAND, COMMAND[::-1]]))
    assert len(stage.plot(record)) == 8
    assert [line.get_label() for line in stage.bode(record)[0].lines] == ["measured x", "measured y", "stage x", "stage y"]
    pyplot.close("all")


def test_parameters_are_told_in_a_frame():
    pytest.importorskip("pandas")
    frame = model(LAG, Gain(0.5)).to_frame().set_index("name")
    assert frame.loc["gain.gain", "value"] == 0.5
    record = model(LAG).simulate(COMMAND)
    noisy = record.signal("measurement").values + 1e-3 * np.random.default_rng(0).standard_normal((len(COMMAND), 1))
    found = hc.identify(hc.from_arrays(COMMAND, noisy, RATE), family="pi", operators=3, verbose=False).to_frame()
    assert {"name", "value", "standard_error"} <= set(found.columns) and len(found) == 3


def test_a_gap_is_drawn_with_its_effect_and_told_in_a_frame():
    pyplot.switch_backend("Agg")
    stage = model(LAG)
    record = stage.simulate(COMMAND)
    noise = 2e-3 * np.random.default_rng(0).standard_normal((len(COMMAND), 1))
    gap = hc.diagnose(hc.from_arrays(COMMAND, 1.1 * record.signal("measurement").values + noise, RATE), stage, verbose=False)
    signals, left = gap.plot()
    assert [line.get_label() for line in signals.lines] == ["measured", "simulated", "with the effects"]
    before, after = (np.std(line.get_ydata()) for line in left.lines)
    assert after < 0.1 * before and gap.model is not None and gap.model.score(record).nrmse > 1
    pyplot.close("all")
    pytest.importorskip("pandas")
    assert gap.to_frame().set_index("parameter").loc["gain", "value"] == pytest.approx(0.1, abs=0.01)


def test_families_take_the_record_of_the_front_door():
    """As it is, or as gapless records where it has gaps."""
    record = model(LAG).simulate(COMMAND)
    found = hc.identify(record, "linear", order=1, verbose=False)
    for records in ([record], record.merge(record).aligned(allow_gaps=True)):
        fit = identify(records, "linear", order=1)
        np.testing.assert_allclose(simulate(fit.model, record.command), record.measurement, atol=1e-6)
        np.testing.assert_allclose(simulate(found, record.command), record.measurement, atol=1e-6)
    with pytest.raises(hc.InputError, match="every tick of one clock"):
        identify([record.merge(record)], "linear", order=1)


def test_the_family_called_model_is_said():
    with pytest.raises(hc.InputError, match="model: the argument is called family: give family='linear'"):
        hc.identify(hc.from_arrays(COMMAND, COMMAND, RATE), model="linear")


def test_what_is_no_record_is_said():
    stage = model(LAG)
    for call in (lambda: hc.identify(COMMAND, "pi"), lambda: stage.score(COMMAND)):
        with pytest.raises(hc.InputError, match="ndarray is no Record: make one by"):
            call()
    for call in (stage.score, stage.plot, stage.bode):
        with pytest.raises(hc.InputError, match="record: str is no Record: make one by hc.read_csv, "):
            call("lab.csv")
    with pytest.raises(hc.InputError, match="2 records: take them one by one"):
        stage.score([stage.simulate(COMMAND)] * 2)


def test_what_is_no_model_is_said():
    record = hc.from_arrays(COMMAND, COMMAND, RATE)
    for call in (lambda: hc.tune("hampi.yaml"), lambda: hc.diagnose(record, "hampi.yaml")):
        with pytest.raises(hc.InputError, match="model: str is no Model: make one by hc.load_model or hc.identify"):
            call()


def test_refusals_name_keywords_in_place_of_options():
    record = hc.from_arrays(COMMAND, COMMAND, RATE)
    with pytest.raises(hc.InputError, match="give model=, baseline= or both"):
        hc.diagnose(record)
    with pytest.raises(hc.InputError, match=r"use the stretches between them \(identify allow_gaps=True\)"):
        hc.identify(record.merge(record), verbose=False)


def test_a_measurement_that_does_not_move_is_scored_without_a_warning(recwarn):
    assert float(model(LAG).score(hc.from_arrays(COMMAND, np.ones(len(COMMAND)), RATE))) == -np.inf
    assert not [each for each in recwarn if each.category is RuntimeWarning]
