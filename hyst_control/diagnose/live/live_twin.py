# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The live twin: the model beside a running system, and an alarm for the gap whose false alarms have a known rate.

Without a gap the residual of a window is Gaussian: r = J z + d + e. J are the model's slopes along its uncertain coefficients,
which run beside it from the same command, so that they fit whatever the command does; z ~ N(0, 1) is how far the coefficients
are off in units of their tolerance, d the model's own imperfection, e white noise.

The coefficients of one plant do not change: the first `calibrate` rows tell where they are (the posterior of z, N(mean, P)) and
how large the noise is. From then on a window's energy, E = |r - J mean|^2 in units of the noise, is a sum of independent
squares whose weights are the eigenvalues of J P J' + D + 1. Its upper quantile is that of a chi-square distribution with the
same first three moments (Imhof, Biometrika 48, 1961, section 4).

The alarm rises after `consecutive` windows in a row above that quantile, and falls after as many below. Every rise so takes
`consecutive` windows of its own, whatever their dependence: the expected number of false alarms in an hour is at most
(windows in an hour) * p / consecutive, and p, a window's share of error, is chosen for this to be `false_alarm_rate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.stats import chi2

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration
from hyst_control.diagnose.noise.white import noise_of
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.model_file import Model, Simulator

STEP = 0.1  # Standard deviations by which a coefficient is moved for its slope


class LiveTwin:
    """The model and its slopes, streamed from the command that the plant gets."""

    def __init__(self, model: Model, sample_time: float) -> None:
        """Prepare the model and its slopes."""
        self._running = [Simulator(model, sample_time)]
        scatter = scatter_of(model)
        for z in STEP * np.eye(len(scatter.coefficients)):
            try:
                self._running.append(Simulator(model.with_stages(scatter.at(z)), sample_time))
            except InputError:
                continue  # a coefficient at the edge of what makes a model has no slope
        self._ahead: list[Array] = []

    @property
    def coefficients(self) -> int:
        """Number of uncertain coefficients."""
        return len(self._running) - 1

    def settle(self, command: Annotated[Array, "A"]) -> None:
        """Begin anew at rest, reached from 0 V on the initial loading curve."""
        self._ahead = [simulator.reset(command) for simulator in self._running]

    def follow(self, commands: Annotated[Array, "N A"]) -> tuple[Array, Array]:
        """Predict the measurement at the ticks of these commands."""
        found = []
        for i, simulator in enumerate(self._running):
            following = simulator.step(commands)
            found.append(np.concatenate([self._ahead[i][None], following[:-1]]))
            self._ahead[i] = following[-1].copy()
        predicted = found[0]
        slopes = [(moved - predicted) / STEP for moved in found[1:]]
        return predicted, np.stack(slopes, axis=2) if slopes else np.zeros((*predicted.shape, 0))


@dataclass(frozen=True)
class Window:
    """Window of the residual."""

    end: int  # Rows of those just added that had come when it was complete
    rms: float  # Over all axes, measurement unit
    nrmse: float  # % of the range since the start, the mean over the axes
    excess: float  # Energy over the threshold, NaN while calibrating
    alarm: bool  # Whether the alarm stands


@dataclass
class GapAlarm:
    """Windows of the residual against their threshold; see the module's text for the statistics."""

    sample_time: float  # S
    # window, calibrate: Rows of a window, and rows from which coefficients and noise are learned
    window: int
    calibrate: int
    stated: Annotated[Array, "A"]  # Noise (rms, measurement unit) that the model states
    false_alarm_rate: float  # Expected false alarms per hour
    consecutive: int  # Windows in a row that raise the alarm, or let it fall
    configuration: Configuration = CONFIGURATION  # All values

    def __post_init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Calibrate anew."""
        self.alarm = False
        self.noise: Array | None = None
        self._mean, self._covariance = np.zeros(0), np.zeros((0, 0))
        self._imperfection = np.zeros(len(self.stated))
        self._lower, self._upper = np.full(len(self.stated), np.inf), np.full(len(self.stated), -np.inf)
        self._learned: list[tuple[Array, Array]] = []
        self._streak = 0
        self.interrupt()

    def interrupt(self) -> None:
        """The rows that follow are not the successors of those before."""
        self._parts: list[tuple[Array, Array]] = []
        self._collected = 0

    def add(
        self, measured: Annotated[Array, "N A"], residual: Annotated[Array, "N A"], slopes: Annotated[Array, "N A K"]
    ) -> list[Window]:
        """Add successive rows."""
        found, begin = [], 0
        self._lower = np.minimum(self._lower, measured.min(axis=0, initial=np.inf))
        self._upper = np.maximum(self._upper, measured.max(axis=0, initial=-np.inf))
        while begin < len(residual):
            end = min(begin + self.window - self._collected, len(residual))
            self._parts.append((residual[begin:end], slopes[begin:end]))
            self._collected += end - begin
            begin = end
            if self._collected == self.window:
                found.append(self._complete(end))
        return found

    @property
    def share(self) -> float:
        """Probability of a window without a gap to exceed its threshold."""
        return min(self.false_alarm_rate * self.consecutive * self.window * self.sample_time / 3600.0, 0.5)

    def _complete(self, end: int) -> Window:
        residual, slopes = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        self.interrupt()
        if self.noise is None:
            excess = np.nan
            self._learn(residual, slopes)
        else:
            excess = self._excess(residual, slopes)
            self._streak = self._streak + 1 if (excess > 1.0) != self.alarm else 0
            if self._streak >= self.consecutive:
                self.alarm, self._streak = not self.alarm, 0
        rms = np.sqrt(np.mean(residual**2, axis=0))
        span = np.maximum(self._upper - self._lower, 1e-12)
        return Window(end, float(np.sqrt(np.mean(rms**2))), float(100.0 * np.mean(rms / span)), float(excess), self.alarm)

    def _learn(self, residual: Array, slopes: Array) -> None:
        """Once there are enough rows: the posterior of the coefficients and the noise, each with what is known of the other."""
        self._learned.append((residual, slopes))
        if len(self._learned) * self.window < self.calibrate:
            return
        residuals, every = zip(*self._learned, strict=True)
        self._learned = []
        grams: Array = sum((_gram(part) for part in every), np.zeros(()))
        sides = sum(np.einsum("nak,na->ak", part, values) for part, values in zip(every, residuals, strict=True))
        left, span = list(residuals), self._upper - self._lower
        policy, floor, error = self.configuration.policy, self.configuration.noise, self.configuration.live_twin.noise_error
        for _ in range(2):
            measured = np.array([noise_of([part[:, axis] for part in left], settings=floor) for axis in range(len(span))])
            noise = np.maximum(measured, np.maximum(floor.least * span, 1e-12))
            # What the model states beyond the noise, and what is too small to matter, is imperfection: slow, not white.
            beyond = np.sqrt(np.maximum(self.stated**2 - (error * noise) ** 2, 0.0))
            self._imperfection = np.hypot(policy.practical_size * span, beyond)
            precision = np.eye(grams.shape[1]) + np.einsum("aij,a->ij", grams, noise**-2)
            self._covariance = np.linalg.inv(precision)
            self._mean = self._covariance @ np.einsum("ak,a->k", sides, noise**-2)
            left = [values - np.einsum("nak,k->na", part, self._mean) for values, part in zip(residuals, every, strict=True)]
        self.noise = noise

    def _excess(self, residual: Array, slopes: Array) -> float:
        """Energy of a window over its threshold."""
        assert self.noise is not None
        left = residual - np.einsum("nak,k->na", slopes, self._mean)
        energy = float(np.sum((left / self.noise) ** 2))
        spread = np.linalg.eigvals(self._covariance @ np.einsum("aij,a->ij", _gram(slopes), self.noise**-2)).real
        weights = np.append(np.maximum(spread, 0.0), len(residual) * np.sum((self._imperfection / self.noise) ** 2))
        return energy / energy_quantile(weights, residual.size, self.share)


def _gram(slopes: Array) -> Array:
    """Products of the slopes (N, A, K) summed over the rows, (A, K, K)."""
    # No matrix product: at this size that wakes the threads of the linear algebra, which then take turns with the loop.
    return np.stack([np.einsum("nk,nl->kl", axis, axis) for axis in np.moveaxis(slopes, 1, 0)])


def energy_quantile(weights: Annotated[Array, "K"], count: int, share: float) -> float:
    """Upper quantile of the squared size of a Gaussian vector.

    By the first three cumulants (Imhof 1961, section 4): with c_k the sum of the k-th powers of the covariance's eigenvalues,
    (|u|^2 - c_1) / sqrt(c_2) is as (X - nu) / sqrt(nu), X chi-square with nu = c_2^3 / c_3^2 degrees of freedom.
    """
    first, second, third = (count + float(np.sum((1.0 + weights) ** power - 1.0)) for power in (1, 2, 3))
    freedom = second**3 / third**2
    return first + (float(chi2.isf(share, freedom)) - freedom) * float(np.sqrt(second / freedom))
