# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A stable linear multi-input multi-output model in modal form, fitted to spectra of commands and measurements.

Time is counted in samples here (sample time 1), poles accordingly: λ = p · sample time. The model of output o is

    Y_o(z) = Σ_i c_io [Σ_j b_ij φ_j(λ_i, z) U_j(z) + t_i ψ(λ_i, z)] + Σ_j D_oj δ_j(z) U_j(z) + d_o(z)

with one term per real pole and two, conjugate to each other, per complex pair. Each pole carries a residue matrix c bᵀ
of rank one, so n poles are n states. φ_j is the exact response of a mode to the held command, late by τ_j samples
(`hyst_control.chain.linear.linear_stages.discretize` computes the same), and t_i, d_o are the transient of a record that is not
periodic: its discrete Fourier transform obeys the same equations with one more input of constant spectrum (Pintelon &
Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012, section 6.3).

Two steps: a frequency-domain subspace estimate (McKelvey, Akçay, Ljung, IEEE Trans. Automatic Control 41 (1996)
960-979) on a warped unit circle that gives the excited band the whole circle, then Levenberg-Marquardt on the output
error, which for spectra of whole records is the simulation error in the time domain (Parseval). Poles are parametrized
as λ = -e^a + j w, so every iterate is stable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.linalg import qr
from scipy.linalg.blas import zherk
from scipy.sparse import csr_array

from hyst_control.base.arrays import Array
from hyst_control.identify.modal.modal_model import Layout, ModalModel, Spectra, Transients, direct_response, mode_response
from hyst_control.identify.solve import gauss_newton
from hyst_control.identify.solve.gauss_newton import End, Rules, Trial, solve_damped

CHUNK = 400_000  # Entries of the matrix W worked on at once: few enough for the cache, enough for the matrix product
SLOWEST = {True: 1.0, False: 0.05}
"""Least decay of a pole, in line spacings, for periodic records and for others.

A resonance narrower than the spacing falls between the lines of a periodic record, and would fit the noise of a single
one; other records show time constants of a few times their length.
"""


def subspace(data: Sequence[Spectra], orders: Sequence[int], delay: Array, hold: str, direct: bool = True) -> list[ModalModel]:
    """Estimate models of several orders from one singular value decomposition; McKelvey et al. 1996, algorithm 2.

    The unit circle is warped by the bilinear map that takes the highest line to three quarters of the circle, so that
    a band far below the sampling rate is as well conditioned as a full one. Unstable poles are reflected.
    """
    outputs = data[0].measurement.shape[1]
    top = max(float(spectra.angle.max()) for spectra in data)
    c = np.tan(min(top, 3.1) / 2) / np.tan(3 * np.pi / 8)
    largest = max(orders)
    blocks = 2 * int(np.ceil(largest / outputs)) + 4
    extra = sum(spectra.command.shape[2] for spectra in data if not spectra.periodic)
    inputs = data[0].command.shape[1] + extra
    columns_u, columns_y = [], []
    used = inputs - extra
    for spectra in data:
        z = np.exp(1j * spectra.angle)
        shift = np.exp(2j * np.arctan(np.tan(spectra.angle / 2) / c))
        powers = shift[:, None] ** np.arange(blocks)
        late = direct_response(delay, "foh" if hold == "foh" else "zoh", z) * (z[:, None] if hold == "zoh" else 1.0)
        for r in range(spectra.command.shape[2]):
            u = np.zeros((len(z), inputs), dtype=complex)
            u[:, : inputs - extra] = spectra.command[:, :, r] * late
            if not spectra.periodic:
                # A transient has the spectrum of one more input; its size is set to that of the commands.
                u[:, used] = np.sqrt(np.mean(np.abs(spectra.command[:, :, r]) ** 2))
                used += 1
            columns_u.append(np.einsum("kq,kj->qjk", powers, u).reshape(blocks * inputs, -1))
            columns_y.append(np.einsum("kq,ko->qok", powers, spectra.measurement[:, :, r]).reshape(blocks * outputs, -1))
    stacked = np.vstack([np.hstack(columns_u), np.hstack(columns_y)])
    real = np.hstack([stacked.real, stacked.imag])
    triangle = qr(real.T, mode="r")[0][: real.shape[0]].T
    rows = blocks * inputs
    left, _, _ = np.linalg.svd(triangle[rows:, rows:], full_matrices=False)
    models = []
    for order in orders:
        basis = left[:, :order]
        a = np.linalg.lstsq(basis[:-outputs], basis[outputs:], rcond=None)[0]
        warped, vectors = np.linalg.eig(a)
        x = (warped - 1) / (warped + 1) * c
        z_poles = (1 + x) / (1 - x)
        modes = (basis[:outputs] @ vectors).T
        keep = (z_poles.imag > 1e-9) | ((np.abs(z_poles.imag) <= 1e-9) & (z_poles.real > 1e-3))
        z_poles = z_poles[keep]
        poles = np.log(np.where(np.abs(z_poles) > 1e-6, z_poles, 1e-6))
        if not poles.size:  # what has no counterpart in continuous time may be a lag: the refinement begins with one in the band
            poles, modes, keep = np.array([-top]), np.ones((1, outputs)), np.array([True])
        poles = -np.maximum(np.abs(poles.real), 1e-5) + 1j * np.where(np.abs(poles.imag) > 1e-9, poles.imag, 0.0)
        c_modes = np.where((poles.imag == 0)[:, None], modes[keep].real, modes[keep])
        c_modes = c_modes / np.maximum(np.linalg.norm(c_modes, axis=1, keepdims=True), 1e-300)
        start = ModalModel(
            poles,
            c_modes,
            np.zeros((len(poles), data[0].command.shape[1]), dtype=complex),
            np.zeros((outputs, data[0].command.shape[1])),
            np.array(delay, dtype=float),
            hold,
        )
        problem = Problem(data, start, direct)
        models.append(problem.fit_linear("b", "D", "t", "d"))
    return models


class Problem:
    """The least-squares problem: error and normal equations at a model with its transients.

    All that varies along the lines is a few scalar functions of the frequency, the columns of W: for every pole and
    every conjugate φ_j U_j, Σ_j b_j ∂φ_j/∂λ U_j, the transient ψ, and the slope along the delays. The model's output,
    and its derivative with respect to each parameter, is W times a small matrix (K, p). So the normal equations need
    the Gram matrix W^H W only, whatever the number of lines.
    """

    def __init__(self, data: Sequence[Spectra], model: ModalModel, direct: bool = True, free_delay: bool = False) -> None:
        compressed = [spectra.compressed() for spectra in data]
        self.data = [kept for kept, _ in compressed]
        self.irreducible = sum(rest for _, rest in compressed)
        self.power = sum(spectra.power for spectra in data)
        self.direct, self.free_delay = direct, free_delay
        slowest = min(SLOWEST[s.periodic] * float((np.diff(s.angle) if len(s.angle) > 1 else s.angle).min()) for s in self.data)
        self.slowest = float(np.log(slowest))
        self.model = model = replace(model, poles=np.minimum(model.poles.real, -slowest) + 1j * model.poles.imag)
        self.records = sum(s.command.shape[2] for s in self.data if not s.periodic)
        n, p, m = len(model.poles), *model.feedthrough.shape
        # A delayed command reaches back before the record: as many samples of its output are free as the delay is long.
        self.edges = 2 + int(np.ceil(model.delay.max()))
        self.transients = Transients(
            [np.zeros(n, dtype=complex) for _ in range(self.records)],
            [np.zeros((self.edges, p)) for _ in range(self.records)],
        )
        self.layout = Layout.of(n, m, p, self.records, self.edges, direct, free_delay)
        self.free = np.ones(self.layout.size, dtype=bool)
        real = model.poles.imag == 0
        self.free[self.layout.indices("pole", n, 2)[real, 1]] = False
        self.free[self.layout.indices("c", 2, n, p)[1, real]] = False
        self.free[self.layout.indices("b", 2, n, m)[1, real]] = False
        self.free[self.layout.indices("t", self.records, 2, n)[:, 1, real]] = False
        # Columns of W: per branch (pole, then conjugates) m driven, 1 slope, the transients, m delay slopes; then the
        # direct part (m, the edges, m delay slopes).
        self.branches = [(i, False) for i in range(n)] + [(i, True) for i in range(n) if not real[i]]
        self.width = m + 1 + self.records + m * free_delay
        self.columns = self.width * len(self.branches) + m + self.records * self.edges + m * free_delay

    def normal_equations(self) -> tuple[Array, Array, float]:
        """JᵀJ (P, P), Jᵀr (P,) and rᵀr over all data at the present model; r is measured minus model."""
        gram, moment, cost = self.gram()
        size = self.layout.size
        matrix, vector = np.zeros((size, size)), np.zeros(size)
        for o, dense in enumerate(self._jacobian_weights()):
            weight = csr_array(dense)  # a parameter moves few columns of W
            adjoint = weight.conj().T
            matrix += (adjoint @ (weight.T @ gram.T).T).real
            vector += (adjoint @ moment[:, o]).real
        return matrix, vector, cost

    def cost(self) -> float:
        """rᵀr over all data at the present model."""
        weights = self._output_weights()
        return self.irreducible + sum(
            float(np.sum(np.abs(measured - functions @ weights) ** 2)) for functions, measured in self._pieces()
        )

    def gram(self) -> tuple[np.ndarray, np.ndarray, float]:
        """W^H W (K, K), W^H r (K, p) and rᵀr at the present model."""
        gram = np.zeros((self.columns, self.columns), dtype=complex, order="F")
        moment = np.zeros((self.columns, self.model.feedthrough.shape[0]), dtype=complex)
        cost = self.irreducible
        weights = self._output_weights()
        for functions, measured in self._pieces():
            residual = measured - functions @ weights
            # Half of W^H W, which is all that a Hermitian matrix needs: of the transposed columns, so that nothing is copied.
            gram = zherk(1.0, functions.T, beta=1.0, c=gram, overwrite_c=1)
            moment += functions.conj().T @ residual
            cost += float(np.sum(np.abs(residual) ** 2))
        # What zherk sums up is the conjugate of W^H W.
        return np.triu(gram, 1).conj() + np.triu(gram).T, moment, cost

    def fit_linear(self, *names: str) -> ModalModel:
        """Minimize the error over parameters in which the output is linear; the others stay."""
        matrix, vector, _ = self.normal_equations()
        chosen = np.zeros(self.layout.size, dtype=bool)
        for name in names:
            chosen[self.layout.slices[name]] = True
        self.apply(solve_damped(matrix, vector, chosen & self.free, 1e-12))
        return self.model

    def apply(self, change: Annotated[Array, "P"]) -> None:
        """Move the present model along a step in the parameters."""
        part = self.layout.slices
        n, p = self.model.outputs.shape
        self.model = self.model.moved(change, self.layout, self.slowest)
        t, d = change[part["t"]].reshape(self.records, 2, n), change[part["d"]].reshape(self.records, self.edges, p)
        self.transients = Transients(
            [old + row[0] + 1j * row[1] for old, row in zip(self.transients.modes, t, strict=True)],
            [old + row for old, row in zip(self.transients.edge, d, strict=True)],
        )

    def movable(self, vector: Annotated[Array, "P"]) -> np.ndarray:
        """Select the parameters that a step may change: not the decay of a pole that is at its bound and would go beyond."""
        movable = self.free.copy()
        at = self.layout.indices("pole", len(self.model.poles), 2)[:, 0]
        movable[at] &= (np.log(-self.model.poles.real) > self.slowest + 1e-9) | (vector[at] > 0)
        return movable

    def rescale(self) -> None:
        """Share each mode's size between c and b equally: the product alone matters."""
        model = self.model
        c, b = np.linalg.norm(model.outputs, axis=1), np.linalg.norm(model.inputs, axis=1)
        ratio = np.sqrt(np.where((c > 0) & (b > 0), np.maximum(b, 1e-300) / np.maximum(c, 1e-300), 1.0))
        self.model = replace(model, outputs=model.outputs * ratio[:, None], inputs=model.inputs / ratio[:, None])
        self.transients = replace(self.transients, modes=[t / ratio for t in self.transients.modes])

    def _pieces(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """W (rows, K) and the measurement (rows, p), a few lines at a time; a row is one line of one record."""
        record = 0
        for spectra in self.data:
            count = spectra.command.shape[2]
            records = range(0) if spectra.periodic else range(record, record + count)
            record += len(records)
            lines = max(CHUNK // (count * self.columns), 1)
            for begin in range(0, len(spectra.angle), lines):
                rows = slice(begin, begin + lines)
                measured = np.swapaxes(spectra.measurement[rows], 1, 2)
                functions = self._functions(np.exp(1j * spectra.angle[rows]), np.swapaxes(spectra.command[rows], 1, 2), records)
                yield functions.reshape(-1, self.columns), measured.reshape(-1, measured.shape[2])

    def _functions(self, z: np.ndarray, u: np.ndarray, records: range) -> np.ndarray:
        """W at some lines z (F,), commands u (F, R, m): (F, R, K). `records` are those of the transients, empty if periodic."""
        model = self.model
        m, hold, delay = u.shape[2], model.hold, model.delay
        functions = np.zeros((*u.shape[:2], self.columns), dtype=complex)
        for branch, (i, conjugate) in enumerate(self.branches):
            pole, b = (np.conj(model.poles[i]), np.conj(model.inputs[i])) if conjugate else (model.poles[i], model.inputs[i])
            at = self.width * branch
            response = mode_response(pole, delay, hold, z)
            h = 1e-5 * (abs(pole) + 1e-3)
            slope = (mode_response(pole + h, delay, hold, z) - mode_response(pole - h, delay, hold, z)) / (2 * h)
            functions[:, :, at : at + m] = response[:, None] * u
            functions[:, :, at + m] = np.matmul(u, (slope * b)[:, :, None])[..., 0]
            if records:
                free = 1.0 / (z - np.exp(pole))
                for r, record in enumerate(records):
                    functions[:, r, at + m + 1 + record] = free
                    t = self.transients.modes[record][i]
                    functions[:, r, at + m] += np.exp(pole) * free**2 * (np.conj(t) if conjugate else t)
            if self.free_delay:
                late = (mode_response(pole, delay + 1e-6, hold, z) - response) / 1e-6
                functions[:, :, at + self.width - m : at + self.width] = (late * b)[:, None] * u
        at = self.width * len(self.branches)
        direct = direct_response(delay, hold, z)
        functions[:, :, at : at + m] = direct[:, None] * u
        if self.free_delay:
            functions[:, :, -m:] = ((direct_response(delay + 1e-6, hold, z) - direct) / 1e-6)[:, None] * u
        for r, record in enumerate(records):
            first = at + m + self.edges * record
            functions[:, r, first : first + self.edges] = z[:, None] ** -np.arange(self.edges)
        return functions

    def _output_weights(self) -> np.ndarray:
        """Matrix (K, p) that maps W to the model's output."""
        model = self.model
        p, m = model.feedthrough.shape
        weights = np.zeros((self.columns, p), dtype=complex)
        for branch, (i, conjugate) in enumerate(self.branches):
            at = self.width * branch
            parts = np.concatenate([model.inputs[i], [0.0], [t[i] for t in self.transients.modes]])
            block = np.outer(parts, model.outputs[i])
            weights[at : at + len(parts)] = np.conj(block) if conjugate else block
        at = self.width * len(self.branches)
        weights[at : at + m] = model.feedthrough.T
        for record, edge in enumerate(self.transients.edge):
            weights[at + m + self.edges * record : at + m + self.edges * (record + 1)] = edge
        return weights

    def _jacobian_weights(self) -> np.ndarray:
        """Matrices (p, K, P) that map W to the derivatives of each output."""
        model, layout = self.model, self.layout
        n, p, m = len(model.poles), *model.feedthrough.shape
        weights = np.zeros((p, self.columns, layout.size), dtype=complex)
        at_pole, at_c, at_b = layout.indices("pole", n, 2), layout.indices("c", 2, n, p), layout.indices("b", 2, n, m)
        at_t, at_delay = layout.indices("t", self.records, 2, n), layout.indices("delay", -1)
        for branch, (i, conjugate) in enumerate(self.branches):
            # A conjugate branch depends on the imaginary part with the opposite sign.
            turn = -1j if conjugate else 1j
            c, b = (np.conj(model.outputs[i]), np.conj(model.inputs[i])) if conjugate else (model.outputs[i], model.inputs[i])
            column = self.width * branch
            driven, slope, free = (
                np.arange(column, column + m),
                column + m,
                np.arange(column + m + 1, column + m + 1 + self.records),
            )
            weights[:, slope, at_pole[i, 0]] += c * model.poles[i].real
            weights[:, slope, at_pole[i, 1]] += c * turn
            transient = np.array([np.conj(t[i]) if conjugate else t[i] for t in self.transients.modes], dtype=complex)
            for o in range(p):
                for half, unit in enumerate((1.0, turn)):
                    weights[o, driven, at_c[half, i, o]] += unit * b
                    weights[o, free, at_c[half, i, o]] += unit * transient
                    weights[o, driven, at_b[half, i]] += unit * c[o]
                    weights[o, free, at_t[:, half, i]] += unit * c[o]
                if self.free_delay:
                    weights[o, column + self.width - m + np.arange(m), at_delay] += c[o]
        column = self.width * len(self.branches)
        for o in range(p):
            if self.direct:
                weights[o, column + np.arange(m), layout.indices("D", p, m)[o]] = 1.0
            if self.free_delay:
                weights[o, self.columns - m + np.arange(m), at_delay] += model.feedthrough[o]
            edges = np.arange(self.records * self.edges)
            weights[o, column + m + edges, layout.indices("d", self.records * self.edges, p)[:, o]] = 1.0
        return weights


def refine(problem: Problem, iterations: int = 40, tolerance: float = 1e-5) -> tuple[float, Array]:
    """Lower the cost of a problem by damped Gauss-Newton from its present model, and leave it at the best one."""
    search = _Search(problem)
    rules = Rules(
        damping=1e-4,
        raised=lambda damping: damping * 8,
        eased=lambda damping: max(damping / 5, 1e-10),
        small=lambda before, after: before - after <= tolerance * (before - problem.irreducible),
        steps=iterations,
        rejections=8,
    )
    problem.rescale()
    found = gauss_newton.minimize(search, search.here(), rules)
    point = found.point
    if not found.linearized:
        # After a small gain the modes' sizes stay as the last step left them.
        search.place(point)
        point = search.linearize(point) if found.end is End.BUDGET else search.here()
    search.place(point)
    return point.cost, point.matrix


@dataclass(frozen=True)
class _Point:
    """A model with its transients, the cost rᵀr, and JᵀJ and Jᵀr where they were last taken."""

    model: ModalModel
    transients: Transients
    cost: float
    matrix: Array
    vector: Array


@dataclass(frozen=True)
class _Search:
    """The search over a problem's models, which is left at the best one."""

    problem: Problem

    def place(self, point: _Point) -> None:
        self.problem.model, self.problem.transients = point.model, point.transients

    def here(self) -> _Point:
        matrix, vector, cost = self.problem.normal_equations()
        return _Point(self.problem.model, self.problem.transients, cost, matrix, vector)

    def cost(self, point: _Point) -> float:
        return point.cost

    def linearize(self, point: _Point) -> _Point:
        self.place(point)
        self.problem.rescale()
        return self.here()

    def step(self, point: _Point, damping: float) -> Trial[_Point]:
        problem = self.problem
        self.place(point)
        problem.apply(solve_damped(point.matrix, point.vector, problem.movable(point.vector), damping))
        return Trial(replace(point, model=problem.model, transients=problem.transients, cost=problem.cost()))
