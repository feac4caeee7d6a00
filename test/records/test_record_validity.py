# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Record checks: nothing is found on sound records of any plant and of measured stages; spoilt ones are named as what they are."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

from hyst_control.base.errors import InputError
from hyst_control.records.excitation.excitation import build
from hyst_control.records.excitation.identification_signals import mhl_identification
from hyst_control.records.validity import causality, checks
from hyst_control.records.validity.beside_model import model_findings
from hyst_control.records.validity.checks import examined, refuse_invalid
from hyst_control.records.validity.findings import NAMES, Finding, Trial
from hyst_control.records.validity.reference_model import averaged
from hyst_control.records.validity.time_shift import clock_beside_model
from hyst_plant_sim.physics import load_plant

pytestmark = pytest.mark.long_file

RATES = {"pea": 5e-5, "pea_published": 5e-5, "third": 5e-5, "fsm": 1e-4, "fsm_published": 1e-4}
PEAK = {"pea": 90.0, "pea_published": 50.0, "third": 90.0, "fsm": 90.0, "fsm_published": 90.0}


def kinds(peak):
    return {
        "diagnostic": {"signal": "diagnostic", "lowest": 0.0, "highest": peak, "duration": 0.5},
        "hampi": {"signal": "hampi_identification", "peak": peak},
        "mhl": {"signal": "mhl_identification", "peak": peak, "sweep_time": 0.3},
        "steps": {"signal": "steps", "lowest": 0.0, "highest": peak, "hold": 0.02, "count": 20},
        "loops": {"signal": "loops", "frequency": 2.0, "peak": peak, "cycles": 2},
        "sine": {"signal": "sine", "frequency": 10.0, "amplitude": 0.4 * peak, "offset": 0.5 * peak, "duration": 0.6},
        "sweep": {
            "signal": "sweep",
            "start_frequency": 1.0,
            "stop_frequency": 1000.0,
            "amplitude": 0.1 * peak,
            "offset": 0.5 * peak,
        },
    }


@cache
def trial(plant, kind, seed=3):
    return driven(plant, kinds(PEAK[plant])[kind], seed, f"{plant} {kind}")


def driven(plant, spec, seed, name):
    truth = load_plant(plant, seed=seed, sample_time=RATES[plant])
    command = build(spec, RATES[plant], len(truth.axes))
    first = truth.reset(command[0])
    return Trial(name, command, np.concatenate([first[None], truth.step(command)[:-1]]), RATES[plant], tuple(truth.axes))


@pytest.fixture(scope="module", autouse=True)
def each_trial_once():
    """Examine each trial once: a sound one is compared with many damaged ones."""
    of_trial, known = checks._of_trial, {}

    def remembered(trial):
        if id(trial) not in known:
            known[id(trial)] = trial, of_trial(trial)  # the trial is kept, so that no other one gets its id
        return known[id(trial)][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "_of_trial", remembered)
        yield


def changed(sound, command=None, measurement=None, **other):
    values = {
        "command": sound.command if command is None else command,
        "measurement": sound.measurement if measurement is None else measurement,
    }
    return Trial(**{**vars(sound), **{key: np.ascontiguousarray(value) for key, value in values.items()}, **other})


def names(*trials):
    found = examined(trials)[0]
    for finding in found:
        assert "\n" not in finding.text() and finding.document()["name"] in NAMES
    return {finding.name for finding in found}


@pytest.mark.parametrize("plant", RATES)
def test_nothing_is_found_on_sound_records_of_a_plant(plant):
    assert examined([trial(plant, kind) for kind in kinds(1.0)])[0] == []


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_nothing_is_found_whatever_drives_a_plant(data):
    plant = data.draw(st.sampled_from(sorted(RATES)))
    peak = PEAK[plant] * data.draw(st.floats(0.3, 1.0))
    spec = data.draw(
        st.one_of(
            st.fixed_dictionaries(
                {
                    "signal": st.just("multi_frequency"),
                    "frequencies": st.lists(st.floats(3.0, 300.0), min_size=3, max_size=3),
                    "amplitudes": st.just([0.2 * peak, 0.15 * peak, 0.1 * peak]),
                    "offset": st.just(0.5 * peak),
                    "duration": st.just(0.5),
                }
            ),
            st.fixed_dictionaries(
                {
                    "signal": st.just("multisine"),
                    "period": st.just(0.1),
                    "lower_frequency": st.just(10.0),
                    "upper_frequency": st.floats(100.0, 2000.0),
                    "rms": st.just(0.08 * peak),
                    "offset": st.just(0.5 * peak),
                    "periods": st.integers(3, 5),
                    "seed": st.integers(0, 1000),
                }
            ),
            st.fixed_dictionaries(
                {
                    "signal": st.just("steps"),
                    "lowest": st.just(0.0),
                    "highest": st.just(peak),
                    "hold": st.floats(0.005, 0.05),
                    "count": st.integers(8, 20),
                    "seed": st.integers(0, 1000),
                }
            ),
        )
    )
    assert examined([driven(plant, spec, data.draw(st.integers(0, 1000)), "random")])[0] == []


def stack_trials(folder):
    tables = [np.loadtxt(folder / "pea_p885" / name)[5:][:, [0, 4]] for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat")]
    tables += [tables[0][2000:2201], tables[1][:7300], tables[1][7400:]]
    return [Trial(f"stack {k}", z[:, :1], z[:, 1:], 0.005, ("x",)) for k, z in enumerate(tables)]


def mirror_trials(folder, levels=(100, 200, 300), realizations=(0, 3)):
    """Records of two periods, with what a frequency response of all of a level's realizations makes of their commands."""
    found = []
    for level in levels:
        u, y = (np.load(folder / "fsm_cubespec" / f"{letter}_{level}mV_train.npy").astype(float) for letter in "uy")
        u, y = u.transpose(3, 2, 0, 1), 1e6 * y.transpose(3, 2, 0, 1)  # (periods, realizations, N, axes)
        spectra = [np.fft.rfft(signal.mean(axis=0), axis=1) for signal in (u, y)]
        response = np.stack([np.linalg.lstsq(spectra[0][:, k], spectra[1][:, k], rcond=1e-6)[0] for k in range(4097)])
        for k in realizations:
            made = np.fft.irfft(np.einsum("fa,fab->fb", spectra[0][k], response), 8192, axis=0)
            both = np.concatenate(u[:, k]), np.concatenate(y[:, k])
            found.append(Trial(f"{level} mV {k}", *both, 1 / 6400, ("x", "y", "z"), np.concatenate([made, made])))
    return found


def oscillator_trials(folder):
    tables = [np.load(folder / "bouc_wen" / f"{name}.npy") for name in ("multisine_train", "multisine_test", "sinesweep_test")]
    return [Trial(str(k), z[:, :1], 1e3 * z[:, 1:], 1 / 750, ("x",)) for k, z in enumerate(tables)]


@pytest.fixture(scope="module")
def measured(request):
    """Two sound records of each measured plant, and the simulation of a model where there is one."""
    folder = request.getfixturevalue("measured_data")
    stack, oscillator = stack_trials(folder), oscillator_trials(folder)
    stack = [changed(each, simulated=12.0 * each.command) for each in (stack[4], stack[0])]
    mirror = [one_period(each) for each in mirror_trials(folder, (200,))]
    return {"stack": stack, "mirror": mirror, "oscillator": [oscillator[0], oscillator[2]]}


@pytest.fixture(scope="module")
def unmodeled(measured):
    """The same without a model, as an identification sees them."""
    return {plant: [without_model(each) for each in trials] for plant, trials in measured.items()}


def without_model(trial):
    return Trial(**{**vars(trial), "simulated": None})


def one_period(trial):
    """Of a record of the mirror; what it shows is shown by the first period already, at half the rows."""
    rows = {name: vars(trial)[name][:8192] for name in ("command", "measurement", "simulated")}
    return Trial(**{**vars(trial), **rows})


def test_nothing_is_found_on_measured_records(measured_data):
    mirror = mirror_trials(measured_data)
    for trials in (
        stack_trials(measured_data),
        [*map(without_model, mirror), *(without_model(one_period(each)) for each in mirror[::2])],
        mirror,
        oscillator_trials(measured_data),
    ):
        assert examined(trials)[0] == []


def shuffled(sound, random):
    return changed(sound, command=random.permutation(sound.command))


def backwards_command(sound, random):
    return changed(sound, command=sound.command[::-1])


def backwards(sound, random):
    return changed(sound, command=sound.command[::-1], measurement=sound.measurement[::-1])


def exchanged(sound, random):
    return changed(sound, command=sound.measurement, measurement=sound.command)


def noise(sound, random):
    return changed(sound, measurement=5.0 + sound.measurement.std() * random.normal(size=sound.command.shape))


def dead(sound, random):
    return changed(sound, measurement=np.full(sound.command.shape, 3.2))


def dying(sound, random):
    half = len(sound.command) // 2
    return changed(
        sound,
        measurement=np.concatenate(
            [sound.measurement[:half], np.repeat(sound.measurement[half : half + 1], len(sound.command) - half, 0)]
        ),
    )


def humming(sound, random):
    wave = np.sin(2 * np.pi * 50.0 * sound.sample_time * np.arange(len(sound.command)))
    return changed(sound, measurement=wave[:, None] + 0.1 * random.normal(size=sound.command.shape))


def drifting(sound, random):
    return changed(sound, measurement=np.cumsum(np.cumsum(random.normal(size=sound.command.shape), axis=0), axis=0))


def of_another_run(sound, random):
    """Motion of about a hundredth of the record's length, which has nothing to do with its command."""
    width = len(sound.command) // 100
    noise = random.normal(size=(len(sound.command) + width - 1, len(sound.axes)))
    smooth = np.apply_along_axis(np.convolve, 0, noise, np.hanning(width), "valid")
    return changed(sound, measurement=smooth)


def saturating_loops(command):
    """The measurement of Bouc and Wen's model, in closed form between the turns of its command."""
    found, state = np.empty_like(command), 0.0
    for k, step in enumerate(np.diff(command, prepend=command[0])):
        limit = np.sign(step) / (0.05 + 0.02 * np.sign(step * state)) if step else 0.0
        state = limit + (state - limit) * np.exp(-abs(step / limit)) if step else state
        found[k] = 0.12 * command[k] - state
    return found


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.05])
def test_noise_on_loops_that_no_line_explains_is_no_reason_to_refuse_them(noise):
    levels = [0, 100, 10, 90, 20, 80, 35, 60, 0, 100]
    command = np.concatenate([np.linspace(*pair, 500, endpoint=False) for pair in zip(levels, levels[1:], strict=False)])
    measured = saturating_loops(command)
    noisy = measured + noise * np.ptp(measured) * np.random.default_rng(1).normal(size=len(measured))
    assert names(Trial("loops", command[:, None], noisy[:, None], 1e-3, ("x",))) == set()
    other = np.concatenate(
        [np.linspace(*pair, 450, endpoint=False) for pair in zip(levels[::-1], [*levels[-2::-1], 70], strict=True)]
    )
    assert names(Trial("loops", other[:, None], noisy[:, None], 1e-3, ("x",))) != set()


REARRANGED = {
    shuffled: {"shuffled_command"},
    backwards_command: {"reversed_command"},
    backwards: {"reversed_time"},
    exchanged: {"swapped_signals"},
    dying: {"dead_sensor"},
}
"""Ways to spoil a record. The name of the fault depends on how the plant answered its command."""
REPLACED = {
    of_another_run: {"unrelated_measurement"},
    noise: {"noise_alone"},
    dead: {"dead_sensor"},
    humming: {"unplugged_sensor"},
    drifting: {"unplugged_sensor"},
}
"""Nothing is left of the plant but its command."""
SPOILT_PLANTS = ("pea", "third", "fsm")


def named(case):
    return getattr(case, "__name__", None)


@pytest.mark.parametrize(
    ("plant", "kind", "spoil"),
    [*product(SPOILT_PLANTS, ("diagnostic", "hampi"), REARRANGED), *product(("pea", "fsm"), ("diagnostic",), REPLACED)],
    ids=named,
)
def test_spoilt_records_are_named_as_what_they_are(plant, kind, spoil):
    expected = {**REARRANGED, **REPLACED}[spoil]
    sound = trial(plant, kind)
    found = names(spoil(sound, np.random.default_rng(1)))
    if spoil is exchanged and kind == "hampi":  # slow loops: the inverse of play operators is play operators, too
        assert found <= expected
    else:
        assert found == expected


def test_an_exchanged_record_is_no_matter_of_its_clocks(monkeypatch):
    """The lead of an inverse may grow over a record, as what is excited changes; the clocks of a sound record stay a note."""
    sound = trial("pea", "diagnostic")
    clocks = [Finding("clock_difference", sound.name, "x", 1e-4, 0.0)]
    monkeypatch.setattr(causality, "clock_difference", lambda *_: clocks)
    assert names(exchanged(sound, None)) == {"swapped_signals"}
    assert causality.direction_findings(sound, causality.CondensedRows.of(sound), 0) == clocks


def test_only_the_axis_that_is_dead_is_named():
    sound = trial("fsm", "diagnostic")
    broken = changed(sound, measurement=np.column_stack([sound.measurement[:, 0], np.zeros(len(sound.command))]))
    assert [(finding.name, finding.axis) for finding in examined([broken])[0]] == [("dead_sensor", "y")]


@pytest.mark.parametrize("plant, kind", [("fsm", "diagnostic"), ("fsm_published", "diagnostic"), ("fsm", "mhl")])
def test_swapped_axes_are_named(plant, kind):
    sound = trial(plant, kind)
    assert names(changed(sound, measurement=sound.measurement[:, ::-1])) == {"swapped_axes"}


@pytest.mark.parametrize("plant", SPOILT_PLANTS)
def test_range_and_sign_against_a_model(plant):
    """The model is the truth's own record of another seed, which is as good as a model gets."""
    sound, model = trial(plant, "diagnostic"), trial(plant, "diagnostic", 4).measurement
    assert names(changed(sound, simulated=model)) == set()
    for factor in (1e3, 1e-3):
        [finding, *_] = examined([changed(sound, measurement=factor * sound.measurement, simulated=model)])[0]
        assert finding.name == "scaled_measurement" and finding.value == pytest.approx(factor, rel=0.1)
    assert names(changed(sound, command=-sound.command, measurement=-sound.measurement, simulated=model)) == {"sign_turned"}
    back = load_plant(plant, seed=4, sample_time=sound.sample_time)
    first, command = back.reset(sound.command[-1]), np.ascontiguousarray(sound.command[::-1])
    model = np.concatenate([first[None], back.step(command)[:-1]])
    assert names(changed(sound, command=command, measurement=sound.measurement[::-1], simulated=model)) == {"reversed_time"}


@pytest.mark.parametrize("plant", SPOILT_PLANTS)
def test_records_that_contradict_each_other_are_named(plant):
    one, other = trial(plant, "diagnostic"), trial(plant, "hampi")
    assert names(one, changed(other, command=-other.command)) == {"sign_turned"}
    assert names(one, changed(other, measurement=1e3 * other.measurement)) == {"scaled_measurement"}
    assert names(one, changed(other, measurement=4.0 * other.measurement)) == {"different_plants"}
    assert names(one, changed(other, axes=tuple("uv"[: len(other.axes)]))) == {"different_plants"}


def in_a_closed_loop(relays=40, bandwidth=4.0, rate=1e4, seed=1):
    """Command and measurement of an integral control of a Preisach stage, a third of whose motion is relays', with a mode of 294 Hz."""
    rng, count = np.random.default_rng(seed), int(2 * rate)
    upper, lower = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(-0.05, 1.05, relays)]))
    upper, lower = upper[upper > lower], lower[upper > lower]
    share = np.exp(-(((upper - lower) / 0.25) ** 2))
    share *= 0.36 / share.sum()
    omega = 2 * np.pi * 294.0
    step, held, *_ = cont2discrete(
        (np.array([[0, 1], [-(omega**2), -2 * 0.036 * omega]]), np.array([[0], [omega**2]]), np.eye(2), np.zeros((2, 1))), 1 / rate
    )
    turn = 2 * np.pi * np.arange(count // 4) * 4 / count
    reference = np.concatenate([size * (0.5 - 0.5 * np.cos(k * turn)) for k, size in ((2, 0.8), (8, 0.6), (20, 0.5), (40, 0.3))])
    reference += 0.05 * np.repeat(rng.choice([-1.0, 1.0], 400), count // 400)
    noise, state, switched = 3e-4 * rng.standard_normal(count), np.zeros(2), -np.ones(len(upper))
    command, measurement = np.zeros(count), np.zeros(count)
    for k in range(count):
        measurement[k] = state[0] + noise[k]
        driven = command[k]
        switched[driven >= upper], switched[driven <= lower] = 1.0, -1.0
        state = step @ state + held[:, 0] * (0.64 * driven + 0.5 * (0.36 + share @ switched))
        if k + 1 < count:
            command[k + 1] = driven + 2 * np.pi * bandwidth / rate * (reference[k] - measurement[k])
    return command, measurement


def test_a_command_that_a_controller_made_of_a_rough_measurement_is_not_exchanged_with_it():
    command, measurement = in_a_closed_loop()
    assert names(Trial("loop", command[:, None], measurement[:, None], 1e-4, ("x",))) == set()


def test_records_too_short_to_judge_or_at_rest_are_left_alone():
    inverse = trial("pea", "diagnostic")
    leading = changed(inverse, command=inverse.measurement, measurement=inverse.command)
    assert names(leading) == {"swapped_signals"}
    assert names(changed(leading, simulated=inverse.command)) == set()  # of a compensator's model
    short = Trial("short", np.arange(20.0)[:, None], np.random.default_rng(0).normal(size=(20, 1)), 1e-3, ("x",))
    rest = Trial("rest", np.ones((500, 1)), np.random.default_rng(0).normal(size=(500, 1)), 1e-3, ("x",))
    assert examined([])[0] == examined([short])[0] == examined([rest, rest])[0] == []
    assert Finding("dead_sensor", "a", "x", 1.0, 0.3).text().startswith("a: x: the measurement does not move")


def test_periods_that_repeat_have_no_lead_by_chance():
    """Four alike of ten blocks each: the two blocks of a period that are held out are those of every period, which no model saw."""
    spec = {"signal": "multisine", "period": 0.1, "lower_frequency": 10.0, "upper_frequency": 170.0}
    spec |= {"rms": 7.2, "offset": 45.0, "periods": 4, "seed": 729}
    assert examined([driven("fsm_published", spec, 0, "few sines")])[0] == []


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.8, 0.98])
def test_a_lag_of_a_good_part_of_a_period_is_no_invalid_record(share):
    """It is what a diagnosis is to find: short records of one sine whose amplitude falls, late by a share of a period."""
    step, frequency = 1e-4, 50.0
    time = np.arange(2400) * step
    envelope = np.interp(time, np.arange(13) / frequency, 80.0 * 0.8 ** np.arange(13))
    command = envelope * np.sin(2 * np.pi * frequency * time)
    noise = 0.002 * np.random.default_rng(0).standard_normal(len(time))
    measured = 0.03 * np.interp(time - share / frequency, time, command, left=0.0) + noise
    for simulated in (None, 0.03 * command[:, None]):
        trial = Trial("late", command[:, None], measured[:, None], step, ("x",), simulated)
        assert not examined([trial])[0]


def permuted(sound, random):
    return changed(sound, measurement=random.permutation(sound.measurement))


def dithering(sound, random):
    """A dead sensor whose last digit flickers."""
    return changed(sound, measurement=np.where(random.integers(0, 2, size=sound.command.shape), 3.201, 3.2))


def walking(sound, random):
    return changed(sound, measurement=np.cumsum(random.normal(size=sound.command.shape), axis=0))


def backwards_measurement(sound, random):
    return changed(sound, measurement=sound.measurement[::-1])


MEASURED = {**REARRANGED, permuted: {"noise_alone"}, backwards_measurement: {"reversed_command"}}
MADE_UP = {**REPLACED, dithering: {"dead_sensor"}, walking: {"unplugged_sensor"}}


@pytest.mark.parametrize(
    ("plant", "spoil"), [*product(["stack", "mirror", "oscillator"], MEASURED), *product(["stack"], MADE_UP)], ids=named
)
def test_spoilt_measured_records_are_named_as_what_they_are(plant, spoil, unmodeled):
    """Without a model, as an identification sees them, beside a sound record."""
    sound, other = unmodeled[plant]
    broken = spoil(sound, np.random.default_rng(1))
    if spoil is exchanged:  # the inverse of play operators is play operators, and that of a mode is also explained by a lead
        possible = {
            "stack": set(),
            "mirror": {"swapped_signals"},
            "oscillator": {"swapped_signals", "early_measurement"},
        }
        assert names(broken) <= possible[plant] and (plant == "stack" or names(broken))
        return
    assert names(other, broken) == {**MEASURED, **MADE_UP}[spoil]


AGAINST = {
    "sign_turned": lambda sound: changed(sound, measurement=-sound.measurement),
    "scaled_measurement": lambda sound: changed(sound, measurement=1e3 * sound.measurement),
    "swapped_axes": lambda sound: changed(sound, measurement=np.roll(sound.measurement, 1, axis=1)),
    "different_plants": lambda sound: changed(sound, measurement=1.7 * sound.measurement),
}


@pytest.mark.parametrize(
    ("plant", "expected"),
    [
        *product(["stack", "mirror", "oscillator"], ["sign_turned", "scaled_measurement"]),
        *[("mirror", "swapped_axes"), ("stack", "different_plants"), ("mirror", "different_plants")],
    ],  # both records of the oscillator differ in range, and the limit is wider
)
def test_measured_records_that_contradict_a_model_or_another_record_are_named(plant, expected, measured, unmodeled):
    sound, other = measured[plant][0], unmodeled[plant][1]
    broken = AGAINST[expected](sound)
    assert names(other, without_model(broken)) == {expected}
    if sound.simulated is not None and expected != "different_plants":  # a gain of 1.7 is what a diagnosis is to find
        assert names(broken) == {expected}


def test_nothing_is_found_beside_a_model_of_a_gain(measured):
    assert names(measured["stack"][0]) == set()


def linear(name, frequencies, sample_time=1e-3, axes=1, count=4096):
    """Sines of some frequencies on every axis, and what a gain of 0.1 with a delay of a sample makes of them."""
    time = np.arange(count + 1)[:, None] * sample_time
    signal = np.zeros((count + 1, axes))
    for number, frequency in enumerate(frequencies):
        signal += np.sin(2 * np.pi * frequency * (1 + 0.013 * np.arange(axes)) * time + number**2 + np.arange(axes) ** 3)
    return Trial(name, signal[1:], 0.1 * signal[:-1], sample_time, AXES[:axes])


AXES = ("a", "b", "c", "d", "e")
MANY = tuple(np.geomspace(3.0, 200.0, 25))


def test_axes_are_told_apart_up_to_four_of_them():
    for count, expected in ((4, {"swapped_axes"}), (5, set())):
        sound = linear("sound", MANY, axes=count)
        swapped = changed(sound, measurement=np.roll(sound.measurement, 1, axis=1))
        assert names(sound) == set()
        assert names(swapped) == expected
        assert names(changed(swapped, simulated=sound.measurement)) == expected
        assert names(sound, changed(swapped, name="swapped")) >= expected


def test_records_that_have_nothing_in_common_are_not_compared():
    sound, rest = linear("sound", MANY), linear("rest", MANY)
    rest = changed(rest, command=np.ones_like(rest.command), measurement=np.random.default_rng(0).normal(size=rest.command.shape))
    assert names(sound, rest) == set()  # one of them does not move
    assert names(linear("low", [5.0, 6.0]), linear("high", [200.0, 260.0])) == set()  # no frequency of the other
    assert names(sound, linear("slow", [0.001 * each for each in MANY], 10.0)) == set()  # no length of a segment fits both


def test_findings_of_several_records_are_told_as_the_first_and_their_number():
    sound = linear("sound", MANY)
    dead = changed(sound, measurement=np.zeros_like(sound.measurement))
    refuse_invalid([sound])
    with pytest.raises(InputError, match=r"dead: a: the measurement does not move.*sensor and its cable$"):
        refuse_invalid([sound, changed(dead, name="dead")])
    with pytest.raises(InputError, match=r"one: a: .* \(and 1 more findings\)$"):
        refuse_invalid([changed(dead, name="one"), changed(dead, name="two")])


def test_of_a_short_record_only_a_dead_sensor_is_told():
    """Coherence and lag of a few hundred samples say nothing."""
    random = np.random.default_rng(2)
    command = 20.0 * np.sin(np.arange(600) / 30.0)[:, None]
    noise = Trial("short", command, random.standard_normal((600, 1)), 1e-3, ("x",))
    assert names(noise) == set()
    assert names(changed(noise, measurement=np.zeros((600, 1)))) == {"dead_sensor"}
    long = changed(noise, np.tile(command, (4, 1)), random.standard_normal((2400, 1)))
    assert names(long) != set(), "of a longer one it is told"


@given(st.integers(2, 9), st.integers(1, 2), st.integers(40, 300))
def test_rows_are_means_twice_over_of_twice_as_many(together, axes, count):
    rows = 1e3 + np.random.default_rng(count).normal(size=(count // together * together, axes))
    mean = np.full(2 * together, 0.5 / together)
    twice = np.stack([np.convolve(np.convolve(column, mean, "valid"), mean, "valid") for column in rows.T], axis=1)
    np.testing.assert_allclose(averaged(rows, together), twice[::together], rtol=1e-12)


def test_a_long_record_whose_fastest_rows_follow_their_command_has_no_lead():
    """Of rows that were averaged a model of few states left more than one with a lead: a sound minute of a mirror was refused."""
    step = 5e-5
    command = np.tile(mhl_identification(step, axes=2), (4, 1))[:1_200_000]  # of a shorter one fewer rows are averaged
    truth = load_plant({"plant": "fsm"}, seed=1, sample_time=step, noise=1e-6)
    measured = np.concatenate([truth.reset(command[0])[None], truth.step(command)[:-1]])
    assert not examined([Trial("minute", command, measured, step, ("x", "y"), unit="mrad")])[0]


@cache
def slow_loops_and_a_small_sweep():
    """3 s at 10 kHz of eight play operators, a mode at 617 Hz and a delay of 0.2 ms, without noise."""
    time = np.arange(30_000) * 1e-4
    swept = np.clip(time - 1.55, 0.0, None)
    rise = np.log(950 / 15) / 1.45
    command = np.interp(time, np.linspace(0.02, 1.5, 9), [0, 112, 8, 100, 18, 84, 30, 70, 50])
    command += 10.0 * np.clip(swept / 0.02, 0, 1) * np.sin(2 * np.pi * 15 * (np.exp(rise * swept) - 1) / rise)
    bent, thresholds, state = 0.06 * command, 3.0 + 6.0 * np.arange(8), np.zeros(8)
    for row, value in enumerate(command):
        state = np.clip(state, value - thresholds, value + thresholds)
        bent[row] += 0.005 * state.sum()
    rate = 2 * np.pi * 617.0
    b, a, _ = cont2discrete(([rate**2], [1.0, 0.054 * rate, rate**2]), 1e-4)
    return command.round(3), np.concatenate([np.zeros(2), lfilter(b.ravel(), a, bent)[:-2]])


@pytest.mark.parametrize("early", [0, 6])
def test_a_lead_that_leaves_next_to_nothing_of_slow_loops_is_told(early):
    """Of 3 s of slow loops and a small sweep a causal model left 6e-5 of the power at a lead of 0.4 ms, which counted as sound."""
    command, answer = slow_loops_and_a_small_sweep()
    measured = answer + 2e-3 * np.random.default_rng(1).standard_normal(len(answer))
    found = examined([Trial("slow", command[: len(command) - early, None], measured[early:, None], 1e-4, ("x",), unit="um")])[0]
    assert [each.name for each in found] == ["early_measurement"] * bool(early)
    assert not early or found[0].value == pytest.approx(4e-4, abs=1e-4)


@pytest.mark.parametrize("seed", [0, 3])
def test_a_record_with_lost_rows_is_not_exchanged(seed):
    """The inverse explained it better than a causal model did, which may not lead: the columns were to be swapped."""
    command, answer = slow_loops_and_a_small_sweep()
    random = np.random.default_rng(seed)
    measured = (answer + 2e-3 * random.standard_normal(len(answer))).round(4)
    lost = random.choice(len(command), 40, replace=False)
    found, noted = examined([Trial("lost", command[:-40, None], np.delete(measured, lost)[:, None], 1e-4, ("x",), unit="um")])
    assert not found and [each.name for each in noted] == ["lost_rows"]


@pytest.mark.parametrize("count, seed", [(20, 0), (60, 32)])
def test_rows_lost_at_random_times_are_no_second_clock_beside_a_model(count, seed):
    """Their shift grows as a random walk does, that of a clock evenly."""
    command, answer = slow_loops_and_a_small_sweep()
    random = np.random.default_rng(seed)
    measured = answer + 2e-3 * random.standard_normal(len(answer))
    lost = np.delete(measured, random.choice(len(command), count, replace=False))
    trial = Trial("lost", command[:-count, None], lost[:, None], 1e-4, ("x",), simulated=answer[:-count, None], unit="um")
    assert clock_beside_model(trial, 0) == []


def test_a_turned_sign_is_no_delay_of_half_a_period():
    """A motion that goes the other way was called 0.5 s late, half of the time, which left more than the turned sign does."""
    time = np.arange(8000) * 1e-3
    expected = (np.sin(2 * np.pi * time) * np.exp(time / 4.0))[:, None]
    for seed in range(8):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(expected.shape)
        [found] = model_findings(Trial("turned", expected, noise - expected, 1e-3, ("x",), simulated=expected), [0])
        assert found.name == "sign_turned"
    late = np.concatenate([np.zeros((500, 1)), expected[:-500]])
    [found] = model_findings(Trial("late", expected, noise + late, 1e-3, ("x",), simulated=expected), [0])
    assert found.name == "late_measurement" and found.value == pytest.approx(0.5, abs=0.002)


def test_a_model_that_explains_the_record_is_not_simulated_in_other_units():
    command = np.cumsum(np.random.default_rng(0).standard_normal((4000, 1)), axis=0)
    highest = []

    def simulate(rows, sample_time):
        highest.append(float(np.abs(rows).max()))
        return 2.0 * rows

    measured = 2.0 * command + 0.1 * np.ptp(command) * np.random.default_rng(1).standard_normal(command.shape)
    assert not model_findings(Trial("stage", command, measured, 1e-3, ("x",), 2.0 * command, "um", simulate), [0])
    assert len(highest) > 2 and max(highest) < 10.0 * np.abs(command).max()


@pytest.mark.parametrize("lost", [0, 24])
def test_rows_that_a_measurement_lost_are_found_beside_a_model(lost):
    rng = np.random.default_rng(lost)
    time = np.arange(12000) / 1e4
    command = sum(np.sin(2 * np.pi * f * time + p) for f, p in zip((4.0, 19.0, 62.0, 170.0), rng.uniform(0, 6.28, 4), strict=True))
    measured = command + 0.02 * rng.standard_normal(len(command))
    kept = np.delete(measured, np.sort(rng.choice(len(measured), lost, replace=False)))
    rows = command[: len(kept), None]
    found = model_findings(Trial("stage", rows, kept[:, None], 1e-4, ("x",), rows, "um", lambda u, _: u), [0])
    assert [each.name for each in found] == ["lost_rows"] * bool(lost)
    assert not lost or "grows to 2." in found[0].detail
