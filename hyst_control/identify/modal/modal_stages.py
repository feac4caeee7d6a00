"""Stages, parameter rows, uncertainty and tolerance of fitted modal models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from hyst_control.chain.linear.linear_stages import Delay, LinearStage, StateSpace, TransferFunction
from hyst_control.chain.stage import Array, Stage
from hyst_control.identify.data.dataset import ParameterRow
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.modal.modal_model import ModalModel
from hyst_control.identify.solve.parameter_covariance import Uncertainty, uncertainty_of


def uncertainty(found: Sequence[Candidate], sample_time: float, axes: Sequence[str]) -> Uncertainty:
    """Uncertainty of frequencies, dampings, gains and delays.

    Parameters
    ----------
    found
        One fitted model of all axes, or one an axis.
    sample_time
        Sample time, s.
    axes
        Names of the axes.

    Returns
    -------
    Uncertainty
        Of the numbers of the chain.
    """
    parts = [candidate.covariance() for candidate in found]
    edges = np.cumsum([0, *(len(index) for index, _ in parts)])

    def chain_of(vector: Array) -> Sequence[Stage]:
        moved = []
        for candidate, (index, _), begin, end in zip(found, parts, edges[:-1], edges[1:], strict=True):
            change = np.zeros(candidate.layout.size)
            change[index] = vector[begin:end]
            moved.append(candidate.model.moved(change, candidate.layout))
        return stages_of(moved[0], sample_time) if len(found) == 1 else diagonal_stages(moved, sample_time)

    spread = block_diag(*(covariance for _, covariance in parts))
    sizes = np.concatenate(
        [
            np.where(
                candidate.layout.belongs(index, "c"), max(float(np.abs(candidate.model.outputs).max(initial=0.0)), 1e-300), 1.0
            )
            for candidate, (index, _) in zip(found, parts, strict=True)
        ]
    )
    return uncertainty_of(chain_of, np.zeros(edges[-1]), spread, axes, sizes)


def stages_of(model: ModalModel, sample_time: float) -> list[Stage]:
    """Convert a model into stages: the delay if there is one, then a `transfer_function` (one axis) or a `state_space`.

    Parameters
    ----------
    model
        The model.
    sample_time
        Sample time, s.

    Returns
    -------
    list[Stage]
        The stages.
    """
    stages: list[Stage] = [Delay(scalar_if_alike(model.delay * sample_time))] if np.any(model.delay > 0) else []
    if model.feedthrough.shape == (1, 1):
        num, den = polynomials(model, sample_time)
        return [*stages, TransferFunction(num, den)]
    a, b, c, d = model.state_space()
    return [*stages, StateSpace(a / sample_time, b / sample_time, c, d)]


def diagonal_stages(models: Sequence[ModalModel], sample_time: float) -> list[Stage]:
    """Convert models of one axis each into stages with per-axis parameters.

    Parameters
    ----------
    models
        A model an axis.
    sample_time
        Sample time, s.

    Returns
    -------
    list[Stage]
        The stages.
    """
    delay = np.array([model.delay[0] * sample_time for model in models])
    pairs = [polynomials(model, sample_time) for model in models]
    longest = max(len(den) for _, den in pairs)
    # A polynomial of lower degree is written with leading zeros.
    num = [np.concatenate([np.zeros(longest - len(num)), num]) for num, _ in pairs]
    den = [np.concatenate([np.zeros(longest - len(den)), den]) for _, den in pairs]
    stages: list[Stage] = [Delay(scalar_if_alike(delay))] if np.any(delay > 0) else []
    return [*stages, TransferFunction([list(row) for row in num], [list(row) for row in den])]


def scalar_if_alike(values: Array) -> float | list[float]:
    """One number where all `values` are the same, else all of them."""
    return float(values[0]) if np.all(values == values[0]) else [float(value) for value in values]


def polynomials(model: ModalModel, sample_time: float) -> tuple[Array, Array]:
    """Convert a model with one input and one output into a ratio of polynomials.

    Parameters
    ----------
    model
        The model.
    sample_time
        Sample time, s.

    Returns
    -------
    num : Array
        Numerator in descending powers of s.
    den : Array
        Monic denominator in descending powers of s.
    """
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


def parameter_rows(candidate: Candidate, sample_time: float, axis: str) -> list[ParameterRow]:
    """Frequency and damping of every pole, the static gain and the delay, with standard errors.

    Parameters
    ----------
    candidate
        A fitted model.
    sample_time
        Sample time, s.
    axis
        Name of the axis, empty where the model is of all axes.

    Returns
    -------
    list[ParameterRow]
        A row a parameter.
    """
    model, layout = candidate.model, candidate.layout.slices
    sigma = candidate.standard_errors(*layout)
    n = len(model.poles)
    pole_sigma = sigma[layout["pole"]].reshape(n, 2)
    suffix = f"[{axis}]" if axis else ""
    rows: list[ParameterRow] = []
    for i, pole in enumerate(model.poles):
        size = abs(pole)
        # λ = -e^a + j w: errors of a and w, to first order those of |λ| and of the damping ratio.
        real, imaginary = abs(pole.real) * pole_sigma[i, 0], pole_sigma[i, 1] if pole.imag else 0.0
        frequency = size / (2 * np.pi * sample_time)
        frequency_error = np.hypot(pole.real * real, pole.imag * imaginary) / size / (2 * np.pi * sample_time)
        rows.append(
            {
                "name": f"frequency[{i}]{suffix}",
                "value": float(frequency),
                "standard_error": float(frequency_error),
                "unit": "Hz",
            }
        )
        if pole.imag:
            damping_error = np.hypot(pole.imag**2 * real, pole.real * pole.imag * imaginary) / size**3
            rows.append(
                {
                    "name": f"damping[{i}]{suffix}",
                    "value": float(-pole.real / size),
                    "standard_error": float(damping_error),
                    "unit": "",
                }
            )
    for j, late in enumerate(model.delay):
        if len(sigma[layout["delay"]]) and late > 0:
            rows.append(
                {
                    "name": f"delay[{j}]{suffix}",
                    "value": float(late * sample_time),
                    "standard_error": float(sigma[layout["delay"]][j] * sample_time),
                    "unit": "s",
                }
            )
    return rows


def tolerance_of(found: Sequence[Candidate], stages: Sequence[Stage]) -> dict[str, float]:
    """Relative standard deviations by parameter name: the median over a parameter's entries.

    The deviation of the residues is taken with b and the delay fixed, as c could be exchanged for them.

    Parameters
    ----------
    found
        The fitted models.
    stages
        Their stages.

    Returns
    -------
    dict[str, float]
        The tolerance of a model file.
    """
    if not all(len(candidate.model.poles) for candidate in found):
        return {}
    poles, residues = [], []
    for candidate in found:
        model, layout = candidate.model, candidate.layout.slices
        sigma = candidate.standard_errors("pole", "c")
        n = len(model.poles)
        pole_sigma = sigma[layout["pole"]].reshape(n, 2)
        poles += list(np.hypot(np.abs(model.poles.real) * pole_sigma[:, 0], pole_sigma[:, 1]) / np.abs(model.poles))
        c_sigma = np.hypot(*sigma[layout["c"]].reshape(2, *model.outputs.shape))
        residues += list(np.linalg.norm(c_sigma, axis=1) / np.maximum(np.linalg.norm(model.outputs, axis=1), 1e-300))
    pole, residue = float(np.median(poles)), float(np.median(residues))
    linear = (stage for stage in stages if isinstance(stage, LinearStage))
    tolerance = {name: value for stage in linear for name, value in stage.pole_tolerances(pole, residue).items()}
    return {name: value for name, value in tolerance.items() if np.isfinite(value)}
