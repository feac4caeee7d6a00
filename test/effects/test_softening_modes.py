"""Modes that soften with amplitude: against a mode of another frequency at steady amplitude, on a measured mirror, and backwards."""

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from evaluation.reproduction import fsm_cubespec_records as records
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.control.feedforward.whole_inverse import lifted_inverse
from hyst_control.effects import insert
from hyst_control.effects.softening_modes import SofteningModes
from hyst_control.model_file import load_model

ROOT = Path(__file__).resolve().parents[2]
STEP = 1e-5


def test_at_a_steady_amplitude_the_mode_is_another_one():
    pole, softening, damping, amplitude = complex(-100.0, 2 * np.pi * 500.0), 0.03, 0.4, 2.0
    stages = (
        TransferFunction([abs(pole) ** 2], [1.0, -2 * pole.real, abs(pole) ** 2]),
        SofteningModes(softening, damping, amplitude),
    )
    time = np.arange(200_000) * STEP
    u = 3.0 + 1.5 * np.sin(2 * np.pi * 450.0 * time)  # after 2 s the amplitude, 1.5 / sqrt(2), has settled to 1e-8
    running = Chain(stages).filter(Sampling(STEP, 1, "foh"))
    running.settle(u[:1])
    found = running.process(u[:, None])[-20_000:, 0]
    root = np.sqrt(1.5 / np.sqrt(2.0) / amplitude)
    moved = complex(pole.real * (1 + damping * root), pole.imag * (1 - softening * root))
    # The mode's own static share is kept: c b / pole, for the pole and its conjugate.
    residue = abs(pole) ** 2 / (pole - pole.conjugate()) / pole * moved
    numerator = np.real([residue + residue.conjugate(), -(residue * moved.conjugate() + residue.conjugate() * moved)])
    response = np.polyval(numerator, 2j * np.pi * 450.0) / np.polyval([1.0, -2 * moved.real, abs(moved) ** 2], 2j * np.pi * 450.0)
    rest = np.polyval(numerator, 0.0) / abs(moved) ** 2
    due = 3.0 * rest + 1.5 * np.imag(response * np.exp(2j * np.pi * 450.0 * time[-20_000:]))
    assert np.abs(found - due).max() < 2e-3 * np.ptp(due)


def test_every_mode_softens_by_its_own_share():
    """Two modes, the higher one first in the model: at a steady amplitude the response is that of two modes moved differently."""
    poles = np.array([complex(-150.0, 2 * np.pi * 700.0), complex(-60.0, 2 * np.pi * 300.0)])
    softening, damping, statics = np.array([0.01, 0.04]), np.array([0.6, 0.2]), np.array([0.4, 1.0])
    modes = [signal.TransferFunction([g * abs(p) ** 2], [1.0, -2 * p.real, abs(p) ** 2]) for g, p in zip(statics, poles)]
    numerator = np.polyadd(np.polymul(modes[0].num, modes[1].den), np.polymul(modes[1].num, modes[0].den))
    mechanics = TransferFunction(numerator, np.polymul(modes[0].den, modes[1].den))
    time, tones = np.arange(200_000) * STEP, (290.0, 680.0)
    u = sum(np.sin(2 * np.pi * tone * time) for tone in tones)  # rms 1: the amplitude is the static gain, 1.4
    stage = SofteningModes(0.02, 0.4, 1.4, softening_factors=(2.0, 0.5), damping_factors=(0.5, 1.5))
    running = Chain((mechanics, stage)).filter(Sampling(STEP, 1, "foh"))
    running.settle(u[:1])
    found = running.process(u[:, None])[-20_000:, 0]

    def response(s: complex, real: np.ndarray, imag: np.ndarray) -> complex:
        """Response of the modes with moved poles, each mode's own static share kept: y = 2 Re(c x), dx/dt = λ x + b u."""
        moved = poles.real * real + 1j * poles.imag * imag
        entering = statics * np.abs(poles) ** 2 / (2j * poles.imag)  # residues of the modes at rest
        kept = entering * moved / poles
        return complex(np.sum(kept / (s - moved) * 1.0 + kept.conj() / (s - moved.conj())))

    def due(real: np.ndarray, imag: np.ndarray) -> np.ndarray:
        return sum(np.imag(response(2j * np.pi * tone, real, imag) * np.exp(2j * np.pi * tone * time[-20_000:])) for tone in tones)

    truth = due(1 + damping, 1 - softening)
    assert np.abs(found - truth).max() < 5e-3 * np.ptp(truth)
    assert np.abs(due(np.full(2, 1.4), np.full(2, 0.98)) - truth).max() > 0.05 * np.ptp(truth)  # one share for both is no match


def test_factors_for_another_number_of_modes_are_refused():
    mode = TransferFunction([4e7], [1.0, 200.0, 4e7])
    with pytest.raises(InputError, match="2 factors for 1 modes"):
        Chain((mode, SofteningModes(0.1, 0.2, 1.0, softening_factors=(1.0, 2.0)))).filter(Sampling(1e-4, 1))


def test_nothing_at_rest_and_nothing_without_amplitude():
    mode = TransferFunction([4e7], [1.0, 200.0, 4e7])
    u = np.concatenate([np.full(50, 5.0), np.linspace(5.0, 6.0, 400)])[:, None]
    results = []
    for stages in ((mode,), (mode, SofteningModes(0.1, 0.2, 1.0))):
        running = Chain(stages).filter(Sampling(1e-4, 1, "foh"))
        results.append(np.concatenate([running.settle(u[0])[None], running.process(u)])[:, 0])
    np.testing.assert_allclose(results[1][:51], results[0][:51], atol=1e-12)
    assert np.abs(results[1] - results[0]).max() > 1e-4


def test_coupled_axes_share_their_modes():
    matrix = TransferFunction([[[1.0], [0.1]], [[0.1], [1.0]]], [[[1e-3, 1.0]] * 2] * 2, coupled=True)
    with pytest.raises(InputError, match="share their modes"):
        Chain((matrix, SofteningModes([0.1, 0.0], 0.0, 1.0))).filter(Sampling(1e-4, 2))


def test_the_measured_mirror_softens(measured_data):
    """A linear model at 200 mV rms against 300 mV: two numbers, fitted on one realisation, take most of the gap off another."""
    levels = records.load_levels()
    whole = load_model(ROOT / "config/models/fsm_cubespec.yaml")
    linear = whole.with_stages((whole.chain.stages[0].mean(),))
    size = 0.25 * float(np.ptp(levels[2].measurement))

    def error(softening: float, damping: float, realisation: int) -> float:
        stage = SofteningModes(softening, damping, size)
        model = linear.with_stages(insert(linear.chain.stages, "motion", stage))
        return float(records.simulation_error(model, levels[2], (realisation,))[0])

    fitted = min(((error(s, d, 4), s, d) for s in np.linspace(0.002, 0.010, 5) for d in (0.0, 0.08)), key=lambda item: item[0])
    before, after = error(0.0, 0.0, 5), error(*fitted[1:], 5)
    assert 1.0 - (after / before) ** 2 > 0.5
    assert error(-fitted[1], fitted[2], 5) > before  # stiffening makes it worse


def test_a_softening_structure_is_inverted_as_a_whole():
    model = load_model(ROOT / "config/models/fsm_cubespec.yaml")
    time = np.arange(1600) * model.sample_time
    window = signal.windows.tukey(len(time), 0.4)
    reference = np.stack(
        [
            window * (2.0 * np.sin(2 * np.pi * (40 + 7 * i) * time) + 0.5 * np.sin(2 * np.pi * (300 + 20 * i) * time + i))
            for i in range(3)
        ],
        axis=1,
    )
    found = lifted_inverse(model, reference, damping=1e-6)
    assert np.sqrt(np.mean((found.measurement - reference) ** 2)) < 1e-3 * np.sqrt(np.mean(reference**2))
    assert np.abs(found.command).max() <= max(model.valid["command"])
