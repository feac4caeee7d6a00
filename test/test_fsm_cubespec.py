"""The measured mirror: the figures of its own documentation, and a linear model against the published one."""

import numpy as np
import pytest

from hyst_control.errors import InputError
from hyst_control.experiments import fsm_cubespec
from hyst_control.experiments.fsm_cubespec import FIT, TEST, load_levels, model_of, simulation_error
from hyst_control.identify.frequency_response import robust_bla
from hyst_control.identify.linear import error_of, refined
from hyst_control.identify.modal_fit import subspace


@pytest.fixture(scope="module")
def levels():
    try:
        return load_levels()
    except InputError as error:
        pytest.skip(str(error))


def test_absent_measurements_are_named_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("HYST_DATA", str(tmp_path))
    with pytest.raises(InputError, match="HYST_DATA"):
        fsm_cubespec.run()


def test_levels_and_noise_are_those_of_the_benchmark(levels):
    for level, rms, noise in zip(levels, (0.1, 0.2, 0.3), (0.045, 0.029, 0.032), strict=True):
        assert np.std(level.command) == pytest.approx(rms, rel=0.02)
        difference = level.measurement[..., 0] - level.measurement[..., 1]
        assert np.sqrt(np.mean(difference**2) / 2) == pytest.approx(noise, rel=0.05)


def test_distortion_is_above_the_noise_and_grows_with_the_level(levels):
    sizes = []
    for level in levels:
        bla = robust_bla(level.command, level.measurement, fsm_cubespec.SAMPLE_TIME)
        assert bla.distortion_variance.sum() > bla.noise_variance.sum()
        sizes.append(np.sqrt(bla.distortion_variance.sum()) * np.std(level.command))
    assert sizes[0] < sizes[1] < sizes[2]


def test_a_linear_model_of_the_highest_level_beats_the_published_one_on_unseen_realisations(levels):
    level = levels[2]
    data = [level.spectra(FIT)]
    found = refined(data, subspace(data, [28], np.zeros(3), "zoh")[0], True, False, 10)
    model = model_of(found.model, "fsm", 1.2)
    error = simulation_error(model, level, TEST)[0]
    assert error < fsm_cubespec.PUBLISHED_OWN[300]
    # The chain, simulated in time, and the fit, computed in frequency, are the same model: the slow modes' start apart, they agree.
    assert error == pytest.approx(100 * error_of(found.model, [level.spectra(TEST)]), rel=0.05)
