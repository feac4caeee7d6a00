# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modal fits to periodic records whose commands are equally late, quicker than those to records of any kind.

Then all inputs of a mode have one response φ_i(z), and the columns φ_i U_j of W (`modal_fit.Problem`) factor line by line:

    (W^H W)_{(i,j),(i',j')} = Σ_k conj(φ_i(z_k)) φ_i'(z_k) S_jj'(k),    S(k) = Σ_r conj(U_r(k)) U_r(k)ᵀ

so that the records are summed first, and the error needs no columns at all. With many inputs this is several times faster than W^H W.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.identify.modal import modal_candidate
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.modal.modal_fit import Problem
from hyst_control.identify.modal.modal_model import ModalModel, Spectra, direct_response, mode_response

LINES = 4096
"""Lines worked on at once."""


@dataclass(frozen=True)
class _Piece:
    """Some lines (F) of periodic records (R): responses (F, B + 1) of the B branches and of the direct path, what drives each.

    `command` (F, R, m), `driving` (F, R, B) = b · U, `residual` (F, R, p): the measurement less the model.
    """

    angle: np.ndarray
    responses: np.ndarray
    command: np.ndarray
    driving: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class _Branches:
    """Poles (B,), output gains (B, p) and input gains (B, m) of all branches: each pole, then the conjugates of the complex ones."""

    poles: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray

    @classmethod
    def of(cls, model: ModalModel, branches: Sequence[tuple[int, bool]]) -> _Branches:
        index = [i for i, _ in branches]
        turned = np.array([conjugate for _, conjugate in branches])
        poles, outputs, inputs = (values[index] for values in (model.poles, model.outputs, model.inputs))
        return cls(
            np.where(turned, poles.conj(), poles),
            np.where(turned[:, None], outputs.conj(), outputs),
            np.where(turned[:, None], inputs.conj(), inputs),
        )


def _pieces(data: Sequence[Spectra], model: ModalModel, branches: _Branches) -> Iterator[_Piece]:
    late = model.delay[:1]
    for spectra in data:
        for begin in range(0, len(spectra.angle), LINES):
            rows = slice(begin, begin + LINES)
            z = np.exp(1j * spectra.angle[rows])
            responses = [mode_response(pole, late, model.hold, z)[:, 0] for pole in branches.poles]
            responses.append(direct_response(late, model.hold, z)[:, 0])
            command = np.swapaxes(spectra.command[rows], 1, 2)
            driving = command @ branches.inputs.T
            stacked = np.stack(responses, axis=1)
            output = (driving * stacked[:, None, :-1]) @ branches.outputs
            output += (command * stacked[:, None, -1:]) @ model.feedthrough.T
            yield _Piece(spectra.angle[rows], stacked, command, driving, np.swapaxes(spectra.measurement[rows], 1, 2) - output)


def periodic_cost(data: Sequence[Spectra], model: ModalModel, branches: Sequence[tuple[int, bool]]) -> float:
    """Sum of the squared error."""
    return sum(float(np.sum(np.abs(piece.residual) ** 2)) for piece in _pieces(data, model, _Branches.of(model, branches)))


def periodic_gram(
    data: Sequence[Spectra], model: ModalModel, branches: Sequence[tuple[int, bool]]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Gram matrix W^H W, W^H r, and the squared error r^H r.

    The columns of W: for every branch the m commands through its response, and the slope of its output with the pole; then the m
    commands of the direct path.
    """
    known = _Branches.of(model, branches)
    count, m, p = len(branches), *model.feedthrough.shape[::-1]
    columns = (m + 1) * count + m
    gram, moment, cost = np.zeros((columns, columns), dtype=complex), np.zeros((columns, p), dtype=complex), 0.0
    driven = ((m + 1) * np.arange(count + 1)[:, None] + np.arange(m)).ravel()
    slopes = (m + 1) * np.arange(count) + m
    late = model.delay[:1]
    for piece in _pieces(data, model, known):
        z, lines = np.exp(1j * piece.angle), len(piece.angle)
        step = 1e-5 * (np.abs(known.poles) + 1e-3)
        ends = [
            [mode_response(pole + way * h, late, model.hold, z)[:, 0] for pole, h in zip(known.poles, step, strict=True)]
            for way in (1, -1)
        ]
        slope = piece.driving * ((np.array(ends[0]) - np.array(ends[1])).T / (2 * step))[:, None]
        conjugate = piece.responses.conj()
        adjoint = np.swapaxes(piece.command.conj(), 1, 2)
        squares = (adjoint @ piece.command).reshape(lines, m * m)
        for i in range(count + 1):
            products = conjugate[:, i, None] * piece.responses[:, i:]
            blocks = (products.T @ squares).reshape(-1, m, m)
            rows = (m + 1) * i + np.arange(m)
            gram[np.ix_(rows, driven[i * m :])] += np.swapaxes(blocks, 0, 1).reshape(m, -1)
        mixed = conjugate.T @ (adjoint @ slope).reshape(lines, -1)
        gram[np.ix_(driven, slopes)] += mixed.reshape(-1, count)
        flat = slope.reshape(-1, count)
        gram[np.ix_(slopes, slopes)] += flat.conj().T @ flat
        moment[driven] += (conjugate.T @ (adjoint @ piece.residual).reshape(lines, -1)).reshape(-1, p)
        moment[slopes] += flat.conj().T @ piece.residual.reshape(-1, p)
        cost += float(np.sum(np.abs(piece.residual) ** 2))
    # Of the driven columns the blocks above the diagonal are there, and all of those that mix both kinds.
    gram[np.ix_(slopes, driven)] = gram[np.ix_(driven, slopes)].conj().T
    for i in range(1, count + 1):
        rows, before = (m + 1) * i + np.arange(m), driven[: i * m]
        gram[np.ix_(rows, before)] = gram[np.ix_(before, rows)].conj().T
    return gram, moment, cost


class PeriodicProblem(Problem):
    """The least-squares problem, by the sums over all records where they allow it."""

    @property
    def alike(self) -> bool:
        """True if all records are periodic and all commands equally late, so that all inputs of a mode have one response."""
        return self.records == 0 and not self.free_delay and bool(np.all(self.model.delay == self.model.delay[0]))

    def cost(self) -> float:
        """rᵀr over all data at the present model."""
        if not self.alike:
            return super().cost()
        return self.irreducible + periodic_cost(self.data, self.model, self.branches)

    def gram(self) -> tuple[np.ndarray, np.ndarray, float]:
        """W^H W (K, K), W^H r (K, p) and rᵀr at the present model."""
        if not self.alike:
            return super().gram()
        gram, moment, cost = periodic_gram(self.data, self.model, self.branches)
        return gram, moment, self.irreducible + cost


def refined(data: Sequence[Spectra], start: ModalModel, iterations: int) -> Candidate:
    """Refine a model of equally late commands by its output error."""
    return modal_candidate.refined(data, start, True, False, iterations, PeriodicProblem)
