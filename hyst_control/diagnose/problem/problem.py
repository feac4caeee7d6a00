# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of one model that a diagnosis works on, simulated from the recorded command, one axis at a time where axes do not mix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.fft import dct

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling, Stage
from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.diagnose.evidence import RoughnessEvidence
from hyst_control.diagnose.problem.per_record_stages import CarriedError
from hyst_control.diagnose.problem.periodic_error import PeriodicError
from hyst_control.diagnose.problem.simulation_cache import MAX_BYTES, KnownLinks
from hyst_control.effects.effect import Surroundings
from hyst_control.effects.placement import mechanics_index
from hyst_control.identify.data.excited_band import lowest_frequency
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum, filtered
from hyst_control.model_file import Model
from hyst_control.records.record import Record

SAME_POLE = 1e-6  # Relative distance up to which two poles are one: axes without coupling have each a copy of the modes
FAR_POLE = 5.0  # A real pole that has no other to make a mode with gets one this many times faster


@dataclass(frozen=True)
class Piece:
    """A gapless stretch of a record: command (N, A) in V, measurement (N, A), and which rows (N,) count (None: all).

    others, driven_beside: measurement and command (N, B) of the plant's other axes, which a simulation of these axes alone does not
    give. foreseen: whether it is a run to come, whose session is not known. recorded: command (N, A) as it was recorded, where `command` is
    without a roughness that the plant did not receive; None: the same. read: measurement (N, A) as the sensor gave it, where
    `measurement` is without a motion from before the record; None: the same.
    """

    command: Array
    measurement: Array
    keep: Mask | None = None
    others: Array | None = None
    foreseen: bool = False
    driven_beside: Array | None = None
    recorded: Array | None = None
    read: Array | None = None

    @property
    def readings(self) -> Array:
        """Measurement as the sensor gave it, on the value grid of its converter."""
        return self.measurement if self.read is None else self.read

    def counted(self, values: Array) -> Array:
        """Select the rows that count."""
        return values if self.keep is None else values[self.keep]

    @property
    def mask(self) -> Mask:
        """True for rows (N,) that count."""
        return np.ones(len(self.command), dtype=bool) if self.keep is None else self.keep

    @property
    def first(self) -> int:
        """First row that counts."""
        return int(np.argmax(self.mask))

    @property
    def driving(self) -> Array:
        """Commands of all axes of the plant in the rows that count."""
        every = self.command if self.driven_beside is None else np.hstack([self.command, self.driven_beside])
        return self.counted(every)


@dataclass(frozen=True)
class Problem:
    """Records of a model, its uncertain coefficients, and the noise (A,) of the measurement."""

    model: Model
    pieces: tuple[Piece, ...]
    sample_time: float
    hold: str
    sigma: Array
    beside_error: bool = False  # True where the model discrepancy is known, from baseline records or from the model file
    own_error: Array | None = None
    """Rms (A,) of what the model leaves on baseline records, measurement unit; None where it is not known."""
    own_correlation: float = 1.0  # Samples of that error per independent one
    own_spectrum: ErrorSpectrum | PeriodicError | None = None
    """Spectrum of that error, or how it comes back, by which flat vectors are whitened; None: only its size and correlation are known."""
    independent: float = 1.0
    """Independent values of that error, as a share of the bins that it dominates: it is one shape, not noise."""
    roughness: tuple[RoughnessEvidence | None, ...] = ()
    """By axis, the roughness of a recorded command that the plant did not receive and `Piece.command` is without."""
    steps: tuple[float, ...] = ()
    """By axis, the step of the measurement's lattice, measurement unit; 0: none. Empty: not looked for."""

    def on(self, command: Array, others: Array | None) -> Problem:
        """The problem on the command (N, A) of a run to come, of which the other axes measure (N, B)."""
        return replace(self, pieces=(Piece(command, np.zeros_like(command), None, others, foreseen=True),))

    @property
    def weight(self) -> float:
        """Weight of a sample in a fit: 1 for white noise, less where the model discrepancy is larger, and slow.

        The own error of e noise rms with n samples per independent one counts as white noise of the energy n (e² - 1) beside the
        noise itself, so that a fit is as certain as its independent samples allow.
        """
        return 1.0 / (1.0 + self.own_correlation * self.own_energy)

    @property
    def own_energy(self) -> float:
        """Energy of the model discrepancy in noise energies, without the noise that was in it: a record of more noise has it too.

        0 where the error is whitened by its spectrum together with the noise.
        """
        if self.own_error is None or self.own_spectrum is not None:
            return 0.0
        stated = np.atleast_1d(np.asarray(self.model.noise.get("sigma", 0.0), dtype=float))
        noise = np.where(stated > 0.0, np.minimum(stated, self.sigma), self.sigma)
        return float(np.mean(np.maximum(self.own_error**2 - noise**2, 0.0) / self.sigma**2))

    @property
    def weighs_own_error(self) -> bool:
        """True where the model discrepancy, known from baseline records, makes samples worth less."""
        return self.own_spectrum is not None or self.own_energy > 0.0

    @property
    def is_carried(self) -> bool:
        """True where the model discrepancy is carried over from a baseline record of the same command."""
        return any(isinstance(stage, CarriedError) for stage in self.model.chain.stages)

    def simulate(self, stages: Sequence[Stage]) -> Array:
        """Simulated measurement of all rows that count, (M,), in units of the noise. Raises `InputError` like the stages do."""
        sampling = Sampling(self.sample_time, len(self.model.axes), self.hold)
        outputs = []
        with np.errstate(all="ignore"):  # a fit may try a chain that is unstable, and turns back
            for index, piece in enumerate(self.pieces):
                record = None if piece.foreseen else index
                first, output = self._links[index].run(tuple(stage.for_record(record) for stage in stages), sampling)
                if self.hold == "zoh":
                    output = np.concatenate([first[None], output[:-1]])
                outputs.append(output)
            return self._flat(outputs)

    def _flat(self, rows: Sequence[Array]) -> Array:
        """The rows (N, A) of every record that count, measurement unit, as a flat vector."""
        counted = [(piece.counted(one) / self.sigma).reshape(-1) for piece, one in zip(self.pieces, rows, strict=True)]
        return self.whitened(np.concatenate(counted))

    def measured(self) -> Array:
        """The measurement in the same form."""
        return self._flat([piece.measurement for piece in self.pieces])

    def nats(self, flat: Array) -> float:
        """Half the squares of a residual (M,), those of the model discrepancy's bins by as much as they are independent."""
        if self.independent == 1.0:
            return 0.5 * self.weight * float(flat @ flat)
        found = 0.0
        for rows, gain in zip(self.by_piece(flat), self._gains, strict=True):
            share = 1.0 - (1.0 - self.independent) * np.maximum(1.0 - gain**2, 0.0)
            found += 0.5 * float(np.sum(share * dct(rows, norm="ortho", axis=0) ** 2))
        return found

    def rows(self, flat: Array) -> Array:
        """A flat vector as rows (M, A) in the measurement's unit."""
        return self.in_noise(flat).reshape(-1, len(self.model.axes)) * self.sigma

    def whitened(self, flat: Array, inverse: bool = False) -> Array:
        """Make the model discrepancy and the noise of a flat vector (M,) in units of the noise white, where its spectrum is known."""
        if self.own_spectrum is None or not np.isfinite(flat).all():
            return flat
        parts = self.by_piece(flat)
        if isinstance(self.own_spectrum, ErrorSpectrum):
            gains = [1.0 / gain for gain in self._gains] if inverse else self._gains
            return np.concatenate([filtered(one, gain).reshape(-1) for one, gain in zip(parts, gains, strict=True)])
        return np.concatenate([self.own_spectrum.whitened(i, one, inverse).reshape(-1) for i, one in enumerate(parts)])

    def in_noise(self, flat: Array) -> Array:
        """Take a flat vector (M,) back to units of the noise: the inverse of `whitened`."""
        return self.whitened(flat, inverse=True)

    def by_piece(self, flat: Array) -> list[Array]:
        """Cut a flat vector (M,) into the rows (N, A) of each record."""
        return np.split(flat.reshape(-1, len(self.model.axes)), self.edges)

    @cached_property
    def _links(self) -> list[KnownLinks]:
        """By piece, the outputs of the filters that were run on its command already."""
        return [KnownLinks(piece.command, MAX_BYTES // len(self.pieces)) for piece in self.pieces]

    @cached_property
    def counts(self) -> list[int]:
        """Rows that count, by piece."""
        return [int(np.count_nonzero(piece.mask)) for piece in self.pieces]

    @cached_property
    def edges(self) -> Array:
        """Rows at which a piece ends and the next begins."""
        return np.cumsum(self.counts)[:-1]

    @cached_property
    def _gains(self) -> list[Array]:
        assert isinstance(self.own_spectrum, ErrorSpectrum)
        return [self.own_spectrum.gain(count, self.sigma, self.sample_time) for count in self.counts]

    @cached_property
    def surroundings(self) -> Surroundings:
        """Record that the size of an effect is judged by."""
        command = np.concatenate([piece.command for piece in self.pieces])
        measurement = np.concatenate([piece.measurement for piece in self.pieces])
        slew = max(float(np.max(np.abs(np.diff(piece.command, axis=0)), initial=0.0)) for piece in self.pieces) / self.sample_time
        poles = shared_poles(self.model)
        return Surroundings(
            self.sample_time,
            max(len(piece.command) for piece in self.pieces) * self.sample_time,
            (float(command.min()), float(command.max())),
            slew,
            (float(measurement.min()), float(measurement.max())),
            len(self.model.axes),
            lowest_frequency([piece.command for piece in self.pieces], self.sample_time),
            self.beside_error,
            shared_modes(poles),
            min(piece.first for piece in self.pieces) * self.sample_time,
            # The first sample at which the command has moved; 0 where there is none.
            min(int(np.argmax(piece.mask & np.any(piece.command != piece.command[0], axis=1))) for piece in self.pieces)
            * self.sample_time,
            self._modelled,
            poles,
        )

    @cached_property
    def _modelled(self) -> tuple[float, float] | None:
        """Range of the nominal model's output on all rows that count; None where it has none."""
        try:
            output = self.rows(self.simulate(self.model.chain.stages))
        except InputError:
            return None
        low, high = float(output.min()), float(output.max())
        return (low, high) if np.isfinite(low) and np.isfinite(high) and low < high else None


def shared_poles(model: Model) -> tuple[complex, ...]:
    """Poles of mechanics that drive the axes together."""
    stages = model.chain.stages
    index = mechanics_index(stages)
    mechanics = None if index is None else stages[index]
    if not isinstance(mechanics, LinearStage) or not mechanics.mixes_axes:
        return ()
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in mechanics.systems(len(model.axes))])
    return tuple(complex(pole) for pole in sorted(poles[poles.imag >= 0.0], key=abs))


def shared_modes(poles: Sequence[complex]) -> tuple[tuple[float, float], ...]:
    """Modes of such poles, each once."""
    found: list[complex] = []
    for pole in poles:
        if all(abs(pole - other) > SAME_POLE * abs(pole) for other in found):
            found.append(pole)
    real = [-pole.real for pole in found if pole.imag == 0.0]
    if len(real) % 2:
        real.append(FAR_POLE * real[-1])
    pairs = [(one * other, one + other) for one, other in zip(real[::2], real[1::2], strict=True)]
    pairs += [(abs(pole) ** 2, -2.0 * pole.real) for pole in found if pole.imag]
    return tuple((float(np.sqrt(square)) / (2 * np.pi), float(0.5 * middle / np.sqrt(square))) for square, middle in pairs)


def axis_model(model: Model, axis: int) -> Model:
    """The model of one axis of a model that does not mix them."""
    noise = {name: value[axis] if np.ndim(value) else value for name, value in model.noise.items()}
    stages = tuple(stage.for_axis(axis) for stage in model.chain.stages)
    discrepancy = {name: [value[axis]] if np.ndim(value) else value for name, value in model.discrepancy.items()}
    return replace(
        model,
        axes=(model.axes[axis],),
        chain=Chain(stages),
        noise=noise,
        uncertainty=uncertainty_of_axis(model.uncertainty, model.axes, axis),
        discrepancy=discrepancy,
    )


def uncertainty_of_axis(uncertainty: Mapping[str, Any], axes: Sequence[str], axis: int) -> dict[str, Any]:
    """The uncertainty of one axis: the rows of its numbers, with a factor of their own covariance."""
    names = list(uncertainty.get("parameters", ()))
    own = [i for i, name in enumerate(names) if name.endswith(f" ({axes[axis]})") or not name.endswith(")")]
    if not own:
        return {}
    rows = np.array(uncertainty["factor"], dtype=float)[own]
    # The symmetric root in units of each number's own deviation keeps a column for each of them.
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    spectrum, vectors = np.linalg.eigh(rows @ rows.T / size[:, None] / size)
    factor = size[:, None] * ((vectors * np.sqrt(np.maximum(spectrum, 0.0))) @ vectors.T)
    return {"parameters": [names[i].removesuffix(f" ({axes[axis]})") for i in own], "factor": factor.tolist()}


def split(problem: Problem) -> list[Problem]:
    """One problem per axis where the axes do not mix, else the problem itself."""
    if len(problem.model.axes) == 1 or any(stage.mixes_axes for stage in problem.model.chain.stages):
        return [problem]
    found = []
    for axis in range(len(problem.model.axes)):
        pieces = tuple(
            Piece(
                np.ascontiguousarray(piece.command[:, axis : axis + 1]),
                np.ascontiguousarray(piece.measurement[:, axis : axis + 1]),
                piece.keep,
                np.delete(piece.measurement, axis, axis=1),
                driven_beside=np.delete(piece.command, axis, axis=1),
            )
            for piece in problem.pieces
        )
        found.append(replace(problem, model=axis_model(problem.model, axis), pieces=pieces, sigma=problem.sigma[axis : axis + 1]))
    return found


def check_unit(model: Model, record: Record, signal: str) -> None:
    """Check that a record's command or measurement has the model's unit; an unknown unit passes."""
    unit = record.signal(signal).unit
    if unit not in ("unknown", model.units[signal]):
        raise InputError(
            f"{record.source}: {signal} is in {unit}, the model's in {model.units[signal]}: give the model of this plant"
        )
