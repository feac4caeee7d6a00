# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Spectra, and the modal model that `modal_fit` fits to them, with the places of its parameters in a vector."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array


@dataclass(frozen=True)
class Spectra:
    """Discrete Fourier transforms of one record or of several of the same length and lines.

    angle (F,): frequency of each line in radian per sample; command (F, m, R) and measurement (F, p, R) for R records;
    periodic: whether each record is a whole number of periods in steady state, so that it has no transient.
    """

    angle: Array
    command: np.ndarray
    measurement: np.ndarray
    periodic: bool = True

    @property
    def power(self) -> float:
        """Sum of squares of the measurement's lines."""
        return float(np.sum(np.abs(self.measurement) ** 2))

    def compressed(self) -> tuple[Spectra, float]:
        """The m columns that matter where periodic records over m per line carry redundant ones, and the squared error no model removes.

        Per line [U; Y] (m + p, R) is turned by a unitary matrix from the right so that U has m nonzero columns only.
        """
        m, count = self.command.shape[1:]
        if not self.periodic or count <= m:
            return self, 0.0
        rotation, _ = np.linalg.qr(np.conj(np.swapaxes(self.command, 1, 2)))
        command, measurement = self.command @ rotation, self.measurement @ rotation
        kept = Spectra(self.angle, command, measurement, True)
        return kept, self.power - kept.power


@dataclass(frozen=True)
class ModalModel:
    """The model of the module's docstring.

    poles (n,) with Im >= 0, one entry per real pole (Im = 0) or pair; outputs (n, p) = c, inputs (n, m) = b, both real
    for a real pole; feedthrough (p, m) = D; delay (m,) in samples; hold of the command.
    """

    poles: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    feedthrough: Array
    delay: Array
    hold: str = "zoh"

    @property
    def states(self) -> int:
        """Number of states: two for each complex pair."""
        return len(self.poles) + int(np.count_nonzero(self.poles.imag))

    @property
    def parameters(self) -> int:
        """Number of free parameters: n (m + p) + m p, and the delays that are not zero."""
        outputs, inputs = self.feedthrough.shape
        count: int = self.states * (outputs + inputs) + int(np.count_nonzero(self.feedthrough)) + int(np.count_nonzero(self.delay))
        return count

    def response(self, angle: Annotated[Array, "F"]) -> np.ndarray:
        """Frequency response of the sampled system."""
        z = np.exp(1j * np.asarray(angle, dtype=float))
        total: np.ndarray = np.einsum("kj,oj->koj", direct_response(self.delay, self.hold, z), self.feedthrough.astype(complex))
        for pole, c, b in zip(self.poles, self.outputs, self.inputs, strict=True):
            pairs = [(pole, c, b)] if pole.imag == 0 else [(pole, c, b), (np.conj(pole), np.conj(c), np.conj(b))]
            for value, left, right in pairs:
                total += np.einsum("o,j,kj->koj", left, right, mode_response(value, self.delay, self.hold, z))
        return total

    def moved(self, change: Annotated[Array, "P"], layout: Layout, slowest: float = -np.inf) -> ModalModel:
        """Move the model along a step in its parameters."""
        part = layout.slices
        (n, p), m = self.outputs.shape, self.inputs.shape[1]
        pole = change[part["pole"]].reshape(n, 2)
        log_decay = np.clip(np.log(-self.poles.real) + np.clip(pole[:, 0], -2.0, 2.0), slowest, 3.0)
        frequency = np.where(self.poles.imag == 0, 0.0, np.clip(self.poles.imag + pole[:, 1], 1e-7, np.pi))
        c, b = change[part["c"]].reshape(2, n, p), change[part["b"]].reshape(2, n, m)
        direct, free_delay = change[part["D"]], change[part["delay"]]
        return replace(
            self,
            poles=-np.exp(log_decay) + 1j * frequency,
            outputs=self.outputs + c[0] + 1j * c[1],
            inputs=self.inputs + b[0] + 1j * b[1],
            feedthrough=self.feedthrough + direct.reshape(p, m) if len(direct) else self.feedthrough,
            delay=np.maximum(self.delay + free_delay, 0.0) if len(free_delay) else self.delay,
        )

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Real block-diagonal A, B, C, D in continuous time, time counted in samples; the delay is apart."""
        rows_a, rows_b, columns_c = [], [], []
        for pole, c, b in zip(self.poles, self.outputs, self.inputs, strict=True):
            if pole.imag == 0:
                rows_a.append(np.array([[pole.real]]))
                rows_b.append(b.real[None])
                columns_c.append(c.real[:, None])
            else:
                # c x + conj(c x) with x' = λ x + b u: the states are Re x and Im x.
                rows_a.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]))
                rows_b.append(np.stack([b.real, b.imag]))
                columns_c.append(np.stack([2 * c.real, -2 * c.imag], axis=1))
        n = self.states
        a = np.zeros((n, n))
        at = 0
        for block in rows_a:
            a[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        m = self.feedthrough.shape[1]
        b = np.vstack(rows_b) if rows_b else np.zeros((0, m))
        c = np.hstack(columns_c) if columns_c else np.zeros((len(self.feedthrough), 0))
        return a, b, c, self.feedthrough


@dataclass(frozen=True)
class Transients:
    """Linear nuisance of the records that are not periodic: per record the modes' t (n,) complex and the edge d (p,)."""

    modes: list[np.ndarray] = field(default_factory=list)
    edge: list[Array] = field(default_factory=list)


def input_taps(pole: complex, late: float, hold: str) -> tuple[complex, complex, complex]:
    """Input taps of dx/dt = λ x + u sampled at 1: x[k] = e^λ x[k-1] + Σ taps[i] w[k-i]."""

    def step(time: float) -> complex:
        value: complex = np.expm1(pole * time) / pole
        return value

    def ramp(time: float) -> complex:
        x = pole * time
        if abs(x) < 1e-3:
            return time * (0.5 + x / 6 + x * x / 24 + x**3 / 120)
        value: complex = (np.expm1(x) - x) / (pole * x)
        return value

    rest = 1.0 - late
    carry = np.exp(pole * rest)
    if hold == "zoh":
        return step(rest), carry * step(late), 0j
    older_up = carry * ramp(late) if late > 0 else 0j
    older_down = carry * step(late) - older_up
    newer_up = ramp(rest)
    newer_down = step(rest) - newer_up
    return rest * newer_up, rest * older_down + older_up + newer_down + late * newer_up, late * older_down


def mode_response(pole: complex, delay: Array, hold: str, z: np.ndarray) -> np.ndarray:
    """Response φ of a mode to every input, as in the module's docstring."""
    back = 1.0 / z
    columns = []
    for late in delay:
        whole = int(np.floor(late + 1e-12))
        t0, t1, t2 = input_taps(pole, late - whole, hold)
        columns.append((t0 + back * (t1 + back * t2)) * back ** (whole + (hold == "zoh")))
    found: np.ndarray = np.stack(columns, axis=-1) / (1.0 - np.exp(pole) * back)[:, None]
    return found


def direct_response(delay: Array, hold: str, z: np.ndarray) -> np.ndarray:
    """Response δ of the direct path to the held command, as in the module's docstring."""
    back = 1.0 / z
    columns = []
    for late in delay:
        whole = int(np.floor(late + 1e-12))
        part = late - whole
        columns.append(back ** (whole + 1) if hold == "zoh" else back**whole * (1.0 - part + part * back))
    return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class Layout:
    """Places of each kind of parameter in the vector: n poles, m inputs, p outputs, `records` with transients.

    Complex parameters have their real parts first, then their imaginary ones: "c" (2, n, p), "b" (2, n, m), "t" (records, 2, n).
    "pole" (n, 2) is a and w of λ = -e^a + j w.
    """

    slices: dict[str, slice]  # Place of every kind
    size: int  # Length P of the vector

    @classmethod
    def of(cls, n: int, m: int, p: int, records: int, edges: int, direct: bool, free_delay: bool) -> Layout:
        """Lay out the parameters of these sizes."""
        sizes = {
            "pole": 2 * n,
            "c": 2 * n * p,
            "b": 2 * n * m,
            "D": p * m * direct,
            "delay": m * free_delay,
            "t": 2 * n * records,
            "d": p * edges * records,
        }
        ends = np.cumsum(list(sizes.values()))
        return cls(
            {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)},
            int(ends[-1]),
        )

    def indices(self, name: str, *shape: int) -> Array:
        """Return the positions of a kind of parameter."""
        part = self.slices[name]
        return np.arange(part.start, part.stop).reshape(shape)
