# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates: effects of the catalogue as unknowns of a fit, alone and together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.signals import lagging
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.diagnose.problem.per_record_stages import with_sensor_delay
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.fit import Unknowns
from hyst_control.effects import EFFECTS, insert
from hyst_control.effects.effect import Effect, Line, Parameter
from hyst_control.effects.placement import mechanics_index

STEP = 0.02  # Of difference quotients by scaled parameters
AT_BOUND = 1e-3  # Distance of a scaled parameter from its bound up to which it is there


@dataclass(frozen=True)
class Member:
    """An effect on an axis (None: all that the problem has) with its parameters on a record."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    problem: Problem
    axis: int | None = None
    frequency: float = 0.0  # Hz, of a line
    fixed: tuple[tuple[str, float], ...] = ()  # Parameters of the variant, which are tried instead of fitted
    shape: Line | None = None  # Shape of a line, where it is not the effect's usual one
    elsewhere: str = ""  # Place, where it is not the effect's usual one
    separate_sizes: bool = False
    """True where each axis has a size of its own: the parameters are then those of one axis after those of the other."""

    @property
    def name(self) -> str:
        """Name of the effect in the catalogue."""
        return self.effect.name

    @property
    def is_line(self) -> bool:
        """True for an effect that shows as a line in the spectrum."""
        return self.effect.line is not None

    @property
    def is_suggested(self) -> bool:
        """True where a parameter starts at what a check of the record suggests: with no slope of the misfit around."""
        return any(parameter.suggested for parameter in self.parameters)

    @property
    def is_of_session(self) -> bool:
        """True where the zero and the drift of a session stand for it already."""
        known = self.effect.companion
        return known is not None and known.beyond not in [parameter.name for parameter in self.parameters]

    @property
    def line(self) -> Line:
        """Shape of the line in the spectrum; only for an effect that is a line."""
        shape = self.shape or self.effect.line
        assert shape is not None, f"{self.name} is no line"
        return shape

    @property
    def is_extra(self) -> bool:
        """True when the effect is added to the output instead of being inserted into the chain."""
        return self.is_line or (self.effect.couples and len(self.problem.model.axes) == 1)

    @property
    def place(self) -> str:
        """Place in the signal chain, such as "dac"."""
        return self.elsewhere or self.effect.place

    @cached_property
    def variant(self) -> tuple[Any, ...]:
        """Key that tells it from other members of a candidate."""
        return self.name, self.axis, round(self.frequency)

    def excludes(self, other: Member) -> bool:
        """True when two members cannot be combined: the same effect twice, or on all axes and again on one of them."""
        everywhere = len(self.problem.model.axes) > 1 and None in (self.axis, other.axis)
        return self.variant == other.variant or self.name == other.name and everywhere

    @property
    def size(self) -> int:
        """Number P of scaled parameters."""
        return 2 * len(self.line.harmonics) * self.line.swells + 1 if self.is_line else len(self.parameters)

    def starts(self) -> list[Array]:
        """Values at which fits begin: every parameter's starts in turn, those of several parameters side by side."""
        if self.is_line:
            return [np.zeros(self.size)]
        longest = max((len(p.starts) for p in self.parameters), default=1)
        found = [tuple(_scaled(p, p.starts[min(i, len(p.starts) - 1)]) for p in self.parameters) for i in range(longest)]
        return [np.array(start) for start in dict.fromkeys(found)]

    def bounds(self) -> tuple[Array, Array, Array]:
        """Lower, upper and the prior's centre of the scaled parameters."""
        if self.is_line:
            wide = np.full(self.size, 1e6)
            wide[-1] = 3.0
            return -wide, wide, np.zeros(self.size)
        lower, upper = (np.array([_scaled(p, getattr(p, side)) for p in self.parameters]) for side in ("lower", "upper"))
        centre = np.array(
            [
                _scaled(p, p.starts[len(p.starts) // 2]) if p.logarithmic or not np.isfinite(p.absent) else _scaled(p, p.absent)
                for p in self.parameters
            ]
        )
        return lower, upper, centre

    def steps(self) -> Array:
        """Steps of difference quotients by the scaled parameters."""
        if self.is_line:
            return np.full(self.size, STEP)
        return np.array([min(STEP, p.smooth / p.scale) if p.smooth else STEP for p in self.parameters])

    def is_at_bound(self, x: Annotated[Array, "P"]) -> bool:
        """True where the effect's size, its first parameter or one that says so, is at an end of its range that only the catalogue sets."""
        if self.is_line:
            return False
        return any(
            _is_at_end(parameter, float(value))
            for i, (parameter, value) in enumerate(zip(self.parameters, x, strict=True))
            if i == 0 or parameter.is_size
        )

    def values(self, x: Annotated[Array, "P"]) -> dict[str, float]:
        """Convert scaled parameters to values, under the names of the gap report."""
        if self.is_line:
            swells = self.line.swells
            # Mean square of the swelling amplitude: that of a Legendre polynomial of degree i is 1 / (2 i + 1).
            square = sum((x[i] ** 2 + x[swells + i] ** 2) / (2 * i + 1) for i in range(swells))
            return {"amplitude": float(np.sqrt(square)) * self._line_scale, "frequency": self._line_frequency(x)}
        if self.separate_sizes:
            return self._values_apart(x)
        found = {**{p.name: _natural(p, value) for p, value in zip(self.parameters, x, strict=True)}, **dict(self.fixed)}
        return {**found, **self.effect.summary(found)}

    def _values_apart(self, x: Array) -> dict[str, float]:
        """Values of every axis, with its name, and that of the axis where the effect is largest, as the gap report has one number."""
        rows, fitted = self._by_axis(x), self.parameters[: len(self.parameters) // len(self.problem.model.axes)]
        each = {
            f"{p.name}_{axis}": row[i]
            for i, p in enumerate(fitted)
            for axis, row in zip(self.problem.model.axes, rows, strict=True)
        }
        most = rows[int(np.argmax([abs(row[0] - fitted[0].absent) for row in rows]))]
        return {**{p.name: most[i] for i, p in enumerate(fitted)}, **each}

    def _by_axis(self, x: Array) -> list[list[float]]:
        """Values of the parameters, axis by axis."""
        values = [_natural(p, value) for p, value in zip(self.parameters, x, strict=True)]
        return np.reshape(values, (len(self.problem.model.axes), -1)).tolist()

    def units(self) -> dict[str, str]:
        """Units by parameter name."""
        unit = self.problem.model.units["measurement"]
        if self.is_line:
            return {"amplitude": unit, "frequency": "Hz"}
        usual = {p.name: unit if p.unit == "unit" else p.unit for p in self.effect.parameters(self.problem.surroundings)}
        return usual | {
            f"{name}_{axis}": own for name, own in usual.items() for axis in self.problem.model.axes if self.separate_sizes
        }

    @property
    def untold(self) -> set[str]:
        """Names of parameters that the gap report does not have, such as a limit that is not there."""
        fitted = (*self.parameters, *self.effect.parameters(self.problem.surroundings))
        return {p.name for p in fitted if not p.told} | {name for name, value in self.fixed if np.isinf(value)}

    def without(self, index: int) -> Member:
        """The same effect with a parameter at the value at which that does nothing."""
        gone = self.parameters[index]
        rest = self.parameters[:index] + self.parameters[index + 1 :]
        return replace(self, parameters=rest, fixed=(*self.fixed, (gone.name, gone.absent)))

    def stage(self, x: Annotated[Array, "P"]) -> Stage:
        """Build the effect's stage for scaled parameters."""
        if self.separate_sizes:
            names = [p.name for p in self.parameters[: len(self.parameters) // len(self.problem.model.axes)]]
            columns = np.transpose(self._by_axis(x)).tolist()
            return self.effect.stage(dict(zip(names, columns, strict=True)), self.problem.surroundings)
        values: dict[str, Any] = self.values(x)
        count = len(self.problem.model.axes)
        if self.axis is not None and count > 1:
            absent = {p.name: p.absent for p in self.effect.parameters(self.problem.surroundings)}
            values = {
                name: [value if i == self.axis else absent.get(name, 0.0) for i in range(count)] for name, value in values.items()
            }
        return self.effect.stage(values, self.problem.surroundings)

    def inserted(self, stages: tuple[Stage, ...], x: Annotated[Array, "P"]) -> tuple[Stage, ...]:
        """Insert the effect's stage at its place."""
        stage = self.stage(x)
        if isinstance(stage, Delay) and self.place == "sensor":
            return with_sensor_delay(stages, stage, self.problem.sample_time, len(self.problem.model.axes))
        return insert(stages, self.place, stage)

    def extra(self, x: Annotated[Array, "P"]) -> Annotated[Array, "M"]:
        """Compute the part that is added to the output; that of the last values is kept: fits ask for it beside many coefficients."""
        key = np.asarray(x).tobytes()
        if key not in self._extras:
            self._extras.clear()
            self._extras[key] = self._flat([basis @ x[:-1] for _, basis in self._bases(x)]) if self.is_line else self._coupled(x)
        return self._extras[key]

    def extra_columns(self, x: Annotated[Array, "P"]) -> Annotated[Array, "M P"]:
        """Derivatives ∂extra/∂x of the part that is added to the output."""
        if self.is_line:
            return self._line_columns(x)
        base, (_, upper, _) = self.extra(x), self.bounds()
        steps = [STEP if x[p] + STEP <= upper[p] else -STEP for p in range(self.size)]
        return np.column_stack([(self.extra(x + step * np.eye(self.size)[p]) - base) / step for p, step in enumerate(steps)])

    @property
    def is_linear(self) -> bool:
        """True where the mechanics' output is linear in some of the parameters."""
        return not self.is_extra and any(parameter.sensor is not None for parameter in self.parameters)

    def linear_columns(self, x: Annotated[Array, "P"]) -> tuple[list[int], Array]:
        """Derivatives by the parameters in which the mechanics' output is linear, about the nominal model.

        One simulation for all that differ in their sensor only, of the added response alone.
        """
        linear = [p for p, parameter in enumerate(self.parameters) if parameter.sensor is not None]
        start = np.array(x, dtype=float)
        start[linear] = 0.0
        key = start.tobytes()
        if key not in self._responses:
            self._responses.clear()
            self._responses[key] = self._linear_columns(start, linear)
        return linear, self._responses[key]

    @cached_property
    def _extras(self) -> dict[bytes, Array]:
        return {}

    @cached_property
    def _responses(self) -> dict[bytes, Array]:
        return {}

    def _linear_columns(self, start: Array, linear: Sequence[int]) -> Array:
        stages, axes = self.problem.model.chain.stages, len(self.problem.model.axes)
        index = mechanics_index(stages)
        if index is not None:
            stages = (*stages[:index], TransferFunction((0.0,), (1.0,)), *stages[index + 1 :])
        alone = self.problem.simulate(stages)
        responses: dict[str, list[tuple[int, int]]] = {}
        for column, p in enumerate(linear):
            responses.setdefault(self.parameters[p].response, []).append((column, p))
        found = np.zeros((len(alone), len(linear)))
        for together in responses.values():
            x = start.copy()
            x[[p for _, p in together]] = 1.0
            added = self.problem.simulate(insert(stages, self.place, self.stage(x))) - alone
            for column, p in together:
                sensor = self.parameters[p].sensor
                assert sensor is not None
                found[sensor::axes, column] = added[sensor::axes]
        return found

    def _coupled(self, x: Array) -> Array:
        values = self.values(x)
        rate = 2 * np.pi * values.get("corner", np.inf) * self.problem.sample_time  # of the low-pass, per sample
        found = []
        for piece in self.problem.pieces:
            assert piece.others is not None, "a coupling without records of other axes"
            other = piece.others.sum(axis=1)
            if np.isfinite(rate):  # exact for a motion that runs straight from sample to sample
                keep = np.exp(-rate)
                before, now = (1.0 - keep) / rate - keep, 1.0 - (1.0 - keep) / rate
                other = lagging(other, float(keep), float(before), float(now))
            found.append(piece.counted(values["coupling"] * other))
        return self.problem.whitened(np.asarray(np.concatenate(found) / self.problem.sigma[0], dtype=np.float64))

    @cached_property
    def _line_size(self) -> float:
        """Noises per unit of x: what the samples of a fit scatter by, which beside the model discrepancy is more than the noise."""
        return float(1.0 / np.sqrt(self.problem.weight))

    @cached_property
    def _line_scale(self) -> float:
        """Measurement unit per unit of x."""
        return float(np.mean(self.problem.sigma)) * self._line_size

    @cached_property
    def _frequency_step(self) -> float:
        return 0.2 / max(len(piece.command) for piece in self.problem.pieces) / self.problem.sample_time

    def _line_frequency(self, x: Array) -> float:
        return float(self.frequency + x[-1] * self._frequency_step)

    def _line_columns(self, x: Array) -> Array:
        swells, columns = self.line.swells, []
        turned = np.concatenate(
            [
                harmonic * np.concatenate([-x[first + swells : first + 2 * swells], x[first : first + swells]])
                for first, harmonic in self._harmonics()
            ]
        )  # by the angle: cos for sin, -sin for cos
        bases = self._bases(x)
        for p in range(self.size - 1):
            columns.append(self._flat([basis[:, p] for _, basis in bases]))
        columns.append(self._flat([2 * np.pi * self._frequency_step * time * (basis @ turned) for time, basis in bases]))
        return np.column_stack(columns)

    def _harmonics(self) -> list[tuple[int, int]]:
        """Of every harmonic: where its coefficients begin, and which it is."""
        return [(2 * i * self.line.swells, harmonic) for i, harmonic in enumerate(self.line.harmonics)]

    def _bases(self, x: Array) -> list[tuple[Array, Array]]:
        """Of every piece the times (N,) and the signals (N, P - 1) of the line: sines, then cosines, their size falling with the order."""
        frequency, found = self._line_frequency(x), []
        for time, shapes in self._shapes:
            angles = [(harmonic, 2 * np.pi * frequency * harmonic * time[:, None]) for _, harmonic in self._harmonics()]
            found.append((time, np.hstack([shapes * wave(angle) / k for k, angle in angles for wave in (np.sin, np.cos)])))
        return found

    @cached_property
    def _shapes(self) -> list[tuple[Array, Array]]:
        """Of every piece the times (N,) and the polynomials (N, K) by which a line swells."""
        found = []
        for piece in self.problem.pieces:
            time = piece.counted(np.arange(len(piece.command), dtype=np.float64)) * self.problem.sample_time
            span = max(len(piece.command) * self.problem.sample_time, 1e-12)
            shapes = np.polynomial.legendre.legvander(2.0 * time / span - 1.0, self.line.swells - 1)
            found.append((time, np.asarray(self._line_size * shapes, dtype=np.float64)))
        return found

    def _flat(self, pieces: Sequence[Array]) -> Array:
        """Signals (N,) of one axis of every piece, as all axes' flat vector."""
        block = np.zeros((sum(map(len, pieces)), len(self.problem.model.axes)))
        block[:, 0 if self.axis is None else self.axis] = np.concatenate(pieces)
        return self.problem.whitened(block.reshape(-1))


@dataclass(frozen=True)
class Candidate:
    """One explanation: one or several effects together."""

    members: tuple[Member, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, in signal order."""
        return tuple(member.name for member in self.members)

    def starts(self) -> list[Array]:
        """Starts of a single effect."""
        return self.members[0].starts()

    def slices(self) -> list[slice]:
        """Slice of the scaled parameters that belongs to each member."""
        edges = np.cumsum([0, *(member.size for member in self.members)])
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def is_at_bound(self, x: Annotated[Array, "P"]) -> bool:
        """True where the size of one of the effects is at the end of its range."""
        return any(member.is_at_bound(x[part]) for member, part in zip(self.members, self.slices(), strict=True))

    def unknowns(self) -> Unknowns:
        """The candidate as unknowns of a fit."""
        parts = list(zip(self.members, self.slices(), strict=True))
        bounds = [member.bounds() for member in self.members]

        def stages(nominal: tuple[Stage, ...], x: Array) -> tuple[Stage, ...]:
            for member, part in parts:
                if not member.is_extra:
                    nominal = member.inserted(nominal, x[part])
            return nominal

        def extra(x: Array) -> Array:
            return cast(Array, sum(member.extra(x[part]) for member, part in parts if member.is_extra))

        def known_columns(x: Array, wanted: Collection[int] | None = None) -> tuple[list[int], Array]:
            indices, found = [], []
            for member, part in parts:
                if wanted is not None and not any(p in wanted for p in range(part.start, part.stop)):
                    continue
                if member.is_extra:
                    indices += list(range(part.start, part.stop))
                    found.append(member.extra_columns(x[part]))
                elif member.is_linear:
                    linear, columns = member.linear_columns(x[part])
                    indices += [part.start + p for p in linear]
                    found.append(columns)
            return indices, np.hstack(found) if found else np.zeros((0, 0))

        lower, upper, centre = (np.concatenate([bound[i] for bound in bounds]) for i in range(3))
        known = any(member.is_extra or member.is_linear for member in self.members)
        return Unknowns(
            stages,
            extra if any(member.is_extra for member in self.members) else None,
            lower,
            upper,
            centre,
            np.concatenate([member.steps() for member in self.members]),
            known_columns if known else None,
            self.unknowns,
        )

    def with_member(self, member: Member) -> Candidate:
        """Add an effect, in signal order, and where it is on several axes in theirs."""
        order = list(EFFECTS)
        return Candidate(tuple(sorted((*self.members, member), key=lambda one: (order.index(one.name), one.axis or 0))))

    def replacing(self, index: int, member: Member) -> Candidate:
        """The same with another realization of one effect."""
        return Candidate((*self.members[:index], member, *self.members[index + 1 :]))

    def without(self, index: int) -> Candidate:
        """Remove one effect."""
        return Candidate(tuple(member for i, member in enumerate(self.members) if i != index))


def _is_at_end(size: Parameter, value: float) -> bool:
    """True where a scaled size is at an end of its range that only the catalogue sets."""
    if not (np.isfinite(size.absent) or size.logarithmic):
        return False
    ends = [end for end in (size.lower, size.upper) if not (end == 0.0 or (end == size.upper and size.absent == np.inf))]
    return any(abs(value - _scaled(size, end)) < AT_BOUND for end in ends)


def _scaled(parameter: Parameter, value: float) -> float:
    return float(np.log(value) if parameter.logarithmic else value) / parameter.scale


def _natural(parameter: Parameter, value: float) -> float:
    return float(np.exp(value * parameter.scale) if parameter.logarithmic else value * parameter.scale)
