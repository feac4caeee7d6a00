# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages, parameter rows, uncertainty and tolerance of fitted modal models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import Delay, LinearStage, StateSpace, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.identify.data.dataset import ParameterRow
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.modal.modal_model import ModalModel
from hyst_control.identify.solve.parameter_covariance import Uncertainty, uncertainty_of


def uncertainty(found: Candidate, sample_time: float, axes: Sequence[str]) -> Uncertainty:
    """Uncertainty of frequencies, dampings, gains and delays."""
    index, spread = found.covariance()

    def chain_of(vector: Array) -> Sequence[Stage]:
        change = np.zeros(found.layout.size)
        change[index] = vector
        return stages_of(found.model.moved(change, found.layout), sample_time)

    largest = max(float(np.abs(found.model.outputs).max(initial=0.0)), 1e-300)
    sizes = np.where(found.layout.belongs(index, "c"), largest, 1.0)
    return uncertainty_of(chain_of, np.zeros(len(index)), spread, axes, sizes)


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


def parameter_rows(candidate: Candidate, sample_time: float) -> list[ParameterRow]:
    """Frequency and damping of every pole, and the delay, with standard errors."""
    model, layout = candidate.model, candidate.layout.slices
    sigma = candidate.standard_errors(*layout)
    n = len(model.poles)
    pole_sigma = sigma[layout["pole"]].reshape(n, 2)
    rows: list[ParameterRow] = []
    for i, pole in enumerate(model.poles):
        size = abs(pole)
        # λ = -e^a + j w: errors of a and w, to first order those of |λ| and of the damping ratio.
        real, imaginary = abs(pole.real) * pole_sigma[i, 0], pole_sigma[i, 1] if pole.imag else 0.0
        frequency = size / (2 * np.pi * sample_time)
        frequency_error = np.hypot(pole.real * real, pole.imag * imaginary) / size / (2 * np.pi * sample_time)
        rows.append(
            {
                "name": f"frequency[{i}]",
                "value": float(frequency),
                "standard_error": float(frequency_error),
                "unit": "Hz",
            }
        )
        if pole.imag:
            damping_error = np.hypot(pole.imag**2 * real, pole.real * pole.imag * imaginary) / size**3
            rows.append(
                {
                    "name": f"damping[{i}]",
                    "value": float(-pole.real / size),
                    "standard_error": float(damping_error),
                    "unit": "",
                }
            )
    for j, late in enumerate(model.delay):
        if len(sigma[layout["delay"]]) and late > 0:
            rows.append(
                {
                    "name": f"delay[{j}]",
                    "value": float(late * sample_time),
                    "standard_error": float(sigma[layout["delay"]][j] * sample_time),
                    "unit": "s",
                }
            )
    return rows


def tolerance_of(found: Candidate, stages: Sequence[Stage]) -> dict[str, float]:
    """Relative standard deviations by parameter name: the median over a parameter's entries.

    The deviation of the residues is taken with b and the delay fixed, as c could be exchanged for them.
    """
    model, layout = found.model, found.layout.slices
    if not len(model.poles):
        return {}
    sigma = found.standard_errors("pole", "c")
    pole_sigma = sigma[layout["pole"]].reshape(len(model.poles), 2)
    c_sigma = np.hypot(*sigma[layout["c"]].reshape(2, *model.outputs.shape))
    pole = np.median(np.hypot(np.abs(model.poles.real) * pole_sigma[:, 0], pole_sigma[:, 1]) / np.abs(model.poles))
    residue = np.median(np.linalg.norm(c_sigma, axis=1) / np.maximum(np.linalg.norm(model.outputs, axis=1), 1e-300))
    linear = (stage for stage in stages if isinstance(stage, LinearStage))
    tolerance = {name: value for stage in linear for name, value in stage.pole_tolerances(float(pole), float(residue)).items()}
    return {name: value for name, value in tolerance.items() if np.isfinite(value)}
