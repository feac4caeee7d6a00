"""The whole-model inverse over a known reference: it must beat every streaming compensator on the model it inverts."""

from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import CrossCoupling, Delay, TransferFunction
from hyst_control.control.feedback.loop import feedforward_rows
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.feedforward.whole_inverse import lifted_inverse
from hyst_control.model_file import Model, Simulator, load_model

MODELS = Path(__file__).resolve().parents[2] / "config" / "models"
HAMPI, MHL = load_model(MODELS / "pea_hampi.yaml"), load_model(MODELS / "fsm_mhl.yaml")


def run(model: Model, command: np.ndarray, sample_time: float) -> np.ndarray:
    plant = Simulator(model, sample_time)
    return np.concatenate([plant.reset(command[0])[None], plant.step(command)[:-1]])


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize("frequency", [10, 100, 150])
def test_it_is_the_ceiling_of_the_hampi_compensator(frequency):
    sample_time = 5e-5
    t = np.arange(round(3 / frequency / sample_time)) * sample_time
    reference = (3.0 - 2.0 * np.cos(2 * np.pi * frequency * t))[:, None]
    streaming = feedforward_rows(reference, build_compensator(HAMPI, "hampi", sample_time=sample_time, limits=(0, 100)))
    result = lifted_inverse(HAMPI, reference, sample_time=sample_time, limits=(0, 100))
    np.testing.assert_array_equal(run(HAMPI, result.command, sample_time), result.measurement)
    assert rms(result.measurement - reference) < 0.6 * rms(run(HAMPI, streaming, sample_time) - reference)
    assert rms(result.measurement - reference) / 4.0 < 0.0025
    assert result.command.min() >= 0.0 and result.command.max() <= 100.0
    assert all(after < before for before, after in zip(result.errors, result.errors[1:]))


def test_two_axes_with_delay_hysteresis_and_dynamics():
    t = np.arange(500) * 2e-4
    reference = 1.0 + 0.8 * np.stack([np.cos(2 * np.pi * 100 * t), np.sin(2 * np.pi * 60 * t)], axis=1)
    result = lifted_inverse(MHL, reference)
    assert rms((result.measurement - reference)[50:]) < 1e-3 * 1.6


def test_a_coupled_linear_model_is_solved_as_by_linear_algebra():
    """Against the lifted matrix itself: least squares with every impulse response in a column."""
    model = Model(
        name="linear",
        axes=("x", "y"),
        units={"command": "V", "measurement": "mrad"},
        sample_time=1e-3,
        chain=Chain((Delay(4e-4), TransferFunction([4e4], [1.0, 250.0, 4e4]), CrossCoupling([[1.0, 0.2], [-0.1, 0.8]]))),
        valid={"command": [-100.0, 100.0]},
    )
    rows = 160
    t = np.arange(rows)
    window = np.where((t > 40) & (t < 120), np.sin(np.pi * (t - 40) / 80) ** 2, 0.0)
    reference = window[:, None] * np.stack([np.sin(t / 7.0), np.cos(t / 5.0)], axis=1)
    columns = []
    for k in range(rows):
        for axis in range(2):
            command = np.zeros((rows, 2))
            command[k, axis] = 1.0
            columns.append(run(model, command, 1e-3).ravel())
    matrix = np.array(columns).T
    exact = np.linalg.lstsq(matrix, reference.ravel(), rcond=1e-6)[0].reshape(rows, 2)
    result = lifted_inverse(model, reference, damping=1e-8)
    assert rms(result.measurement - reference) < 1e-3 * rms(reference)
    assert rms(result.command - exact) < 0.01 * rms(exact)


@pytest.mark.parametrize("reference", [np.zeros((1, 1)), np.zeros((5, 2)), np.array([[0.0], [np.nan]])])
def test_unusable_references_are_refused(reference):
    with pytest.raises(InputError, match="reference"):
        lifted_inverse(HAMPI, reference)
