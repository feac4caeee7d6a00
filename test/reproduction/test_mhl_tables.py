"""What the MHL experiment's tables say of made-up signals whose answer is known."""

import numpy as np
import pytest

from hyst_control.reporting.tables import Table
from hyst_control.reproduction.mhl import SAMPLE_TIME, Part
from hyst_control.reproduction.mhl_tables import error_spectrum


def test_the_error_at_one_frequency_falls_into_its_parts():
    """Mean, fundamental, harmonics and noise of known rms, in % of a reference of range 2; all together are the NRMSE."""
    time = SAMPLE_TIME * np.arange(1000)
    part = Part(0, 1000, 100)

    def tone(harmonic: int, rms: float) -> np.ndarray:
        return rms * np.sqrt(2.0) * np.sin(2 * np.pi * 100.0 * harmonic * time + harmonic)

    reference = np.cos(2 * np.pi * 100.0 * time)
    noise = np.random.default_rng(0).normal(0.0, 0.002, 1000)
    error = 0.01 + tone(1, 0.03) + tone(2, 0.005) + tone(3, 0.02) + tone(5, 0.004) + tone(7, 0.003) + noise
    signals = {"reference": reference[:, None], "measurement": (reference + error)[:, None]}
    table = Table("test")
    error_spectrum(table, {"loop": signals}, part, SAMPLE_TIME)
    found = {row.quantity: row.value for row in table.rows}
    expected = {
        "mean": 0.5,
        "fundamental": 1.5,
        "second harmonic": 0.25,
        "third harmonic": 1.0,
        "harmonics 4 to 10": 0.25,
        "rest": 0.1,
    }
    assert found == pytest.approx(expected, abs=0.02)
    nrmse = 100.0 * np.sqrt(np.mean(error[100:] ** 2)) / np.ptp(reference[100:])
    assert np.sqrt(sum(value**2 for value in found.values())) == pytest.approx(nrmse, rel=1e-9)
