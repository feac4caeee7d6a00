# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages and numbers of fitted modal models."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.data.fit import Number
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.modal.modal_model import ModalModel


def axis_fit(found: Candidate, sample_time: float) -> AxisFit:
    """The fit of all axes; its parameters are changes of those of the model."""
    index, spread = found.covariance()

    def model(vector: Array) -> ModalModel:
        change = np.zeros(found.layout.size)
        change[index] = vector
        return found.model.moved(change, found.layout)

    largest = max(float(np.abs(found.model.outputs).max(initial=0.0)), 1e-300)
    return AxisFit(
        lambda vector: stages_of(model(vector), sample_time),
        np.zeros(len(index)),
        spread,
        lambda vector: _numbers(model(vector), sample_time),
        sizes=np.where(found.layout.belongs(index, "c"), largest, 1.0),
    )


def _numbers(model: ModalModel, sample_time: float) -> list[Number]:
    """Frequency and damping of every pole, and the delays."""
    found = []
    for i, pole in enumerate(model.poles):
        found.append(Number(f"frequency[{i}]", abs(pole) / (2 * np.pi * sample_time), "Hz"))
        if pole.imag:
            found.append(Number(f"damping[{i}]", -pole.real / abs(pole)))
    return found + [Number(f"delay[{j}]", late * sample_time, "s") for j, late in enumerate(model.delay) if late > 0]


def stages_of(model: ModalModel, sample_time: float) -> list[Stage]:
    """Convert a model into stages: the delay if there is one, then a `transfer_function` (one axis) or a `state_space`."""
    stages: list[Stage] = [Delay(scalar_if_alike(model.delay * sample_time))] if np.any(model.delay > 0) else []
    if model.feedthrough.shape == (1, 1):
        num, den = polynomials(model, sample_time)
        return [*stages, TransferFunction(num, den)]
    a, b, c, d = model.state_space()
    return [*stages, StateSpace(a / sample_time, b / sample_time, c, d)]


def scalar_if_alike(values: Array) -> float | list[float]:
    """One number where all `values` are the same, else all of them."""
    return float(values[0]) if np.all(values == values[0]) else [float(value) for value in values]


def polynomials(model: ModalModel, sample_time: float) -> tuple[Array, Array]:
    """Convert a model with one input and one output into a ratio of polynomials."""
    poles, residues = [], []
    for pole, c, b in zip(model.poles, model.outputs[:, 0], model.inputs[:, 0], strict=True):
        poles += [pole] if pole.imag == 0 else [pole, np.conj(pole)]
        residues += [c * b] if pole.imag == 0 else [c * b, np.conj(c * b)]
    poles_s, residues_s = np.array(poles, dtype=complex) / sample_time, np.array(residues, dtype=complex) / sample_time
    den = np.atleast_1d(np.poly(poles_s).real)
    num = float(model.feedthrough[0, 0]) * den
    for i in range(len(poles_s)):
        num[1:] += (residues_s[i] * np.poly(np.delete(poles_s, i))).real
    return np.trim_zeros(num, "f") if np.any(num) else np.zeros(1), den
