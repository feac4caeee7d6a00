# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Inverses of the MHL model's rate-dependent hysteresis H_D = H_S + Ψ, as chains of stages (MHL paper §3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Parallel, Sampling, Stage
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.linear.linear_stages import Delay, LinearStage, RateCorrection, StateSpace, TransferFunction
from hyst_control.chain.linear.symmetric_filter import smooth_weights, weighted_sum
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.chain.stage import per_axis_scalars
from hyst_control.control.feedforward.inverse_dynamics import RINGING_LIMIT, DiscreteSystem, discrete_stage, sampled_systems

LINES, TAPS = 256, 4  # Frequencies at which the sampled Ψ is fitted, and samples that its numerator counts beyond its denominator


def rate_dependent_parts(core: Stage | None) -> tuple[Madelung, RateCorrection | None]:
    """H_S and Ψ of `core`, an MHL model's rate-dependent part. Raises `InputError` when it is something else."""
    if isinstance(core, Madelung):
        return core, None
    flat = [stage for branch in core.branches for stage in branch] if isinstance(core, Parallel) else []
    hysteresis = [stage for stage in flat if isinstance(stage, Madelung)]
    correction = [stage for stage in flat if isinstance(stage, RateCorrection)]
    if len(hysteresis) != 1 or len(correction) > 1 or len(flat) != len(hysteresis) + len(correction):
        raise InputError(
            "kind: an MHL compensator needs a model with a madelung stage, alone or in parallel with one "
            f"rate_correction, not {core.name if core else 'one without hysteresis'}"
        )
    return hysteresis[0], correction[0] if correction else None


def inverted(stage: Madelung) -> Madelung:
    """The curves of a Madelung `stage` with input and output exchanged."""
    return replace(stage, inverse=not stage.inverse)


def inverse_rate_correction(stage: Madelung, correction: RateCorrection, axes: int) -> RateCorrection:
    """Ψ' such that (1/a + Ψ')(a + Ψ) = 1 with a the mean slope of H_S: again a first-order lag driven by the rate.

    1 / (a + k1 s / (k2 s + b2)) - 1 / a = (-k1 / a²) s / ((k2 + k1 / a) s + b2).
    """
    a = stage.slope_of_curves(axes)
    k1, k2, b2 = per_axis_scalars(correction, axes, "k1", "k2", "b2")
    if np.any(k1 <= -a * k2):
        raise InputError(
            "k1: at high frequency the rate correction cancels the hysteresis (-k1 / k2 is not below the mean slope): it has no stable "
            "inverse; take kind mhl_static"
        )
    return RateCorrection((-k1 / a**2).tolist(), (k2 + k1 / a).tolist(), 0.0, b2.tolist())


def constant_removed(correction: RateCorrection | None, axes: int) -> list[Stage]:
    """Offset that subtracts the constant b1 / b2 of `correction`, for so many `axes`; no stage where there is none."""
    if correction is None:
        return []
    b1, b2 = per_axis_scalars(correction, axes, "b1", "b2")
    constant = b1 / b2
    return [Offset((-constant).tolist())] if np.any(constant) else []


def composite(
    hysteresis: Madelung,
    correction: RateCorrection | None,
    rate_filter: Sequence[float] | None,
    sampling: Sampling | None = None,
    smoothing: int = 0,
) -> list[Stage]:
    """u_ff = H_S^-1[y] + N(s) Ψ'[y] from an inverse curve and a leading correction (MHL paper Eq. 6, 7, §4.4).

    An exactly discretized rate of a reference that is linear between samples is half a sample late, which at 100 Hz and 5 kHz is
    0.9 % too much amplitude. Tustin's rule avoids that.
    """
    # smoothing: order of an N without phase in place of the rate filter, which needs `sampling`: smooth weights, one tick ahead.
    # The command is late by `smoothing` + 1 ticks. 0 for none
    if correction is None:
        return [hysteresis]
    if smoothing:
        if sampling is None:
            raise InputError("smoothing: an N(s) without phase is a sampled one: take discretisation tustin")
        axes, period = sampling.axes, sampling.sample_time
        ahead: tuple[Stage, ...] = (tustin_lead(correction, None, sampling), weighted_sum(smooth_weights(smoothing), axes, period))
        late = weighted_sum(np.eye(1, smoothing + 2, smoothing + 1)[0], axes, period)
        return [Parallel(((hysteresis, late), ahead))]
    lead: list[Stage] = [correction]
    if sampling is not None:
        lead = [tustin_lead(correction, rate_filter, sampling)]
    elif rate_filter is not None:
        lead.append(TransferFunction([float(rate_filter[-1])], [float(value) for value in rate_filter]))
    return [Parallel(((hysteresis,), tuple(lead)))]


def tustin_lead(correction: RateCorrection, rate_filter: Sequence[float] | None, sampling: Sampling) -> Stage:
    """(k1 s + b1) / (k2 s + b2) times N(s), discretized by Tustin's rule for all axes."""
    values = per_axis_scalars(correction, sampling.axes, "k1", "b1", "k2", "b2")
    denominator = [1.0] if rate_filter is None else [float(value) for value in rate_filter]
    poles_of_filter, scale = np.roots(denominator), denominator[-1] / denominator[0]
    found = []
    for k1, b1, k2, b2 in zip(*values, strict=True):
        from scipy.signal import bilinear_zpk  # here, not above: it takes longer to import than all that a node needs

        zeros, poles, gain = bilinear_zpk([-b1 / k1], [-b2 / k2, *poles_of_filter], scale * k1 / k2, 1.0 / sampling.sample_time)
        found.append(DiscreteSystem(np.asarray(zeros, dtype=complex), np.asarray(poles, dtype=complex), float(np.real(gain))))
    return discrete_stage(found, sampling.sample_time)


def whole_inverse(
    stage: Madelung, correction: RateCorrection | None, after: Sequence[Stage], sampling: Sampling, passes: int
) -> list[Stage]:
    """Solve H_S[v] + Ψ[v] = w by v_0 = H_S^-1[w] + Ψ'[w], v_j+1 = H_S^-1[w - Ψ[v_j]].

    The result is a chain of chains without an algebraic loop. The error shrinks per pass by |Ψ| / a, with the published parameters
    0.25 at 100 Hz and 0.56 at most; Ψ is the sampled one, in which a lag that is much faster than the sample time is small.
    """
    inverse = inverted(stage)
    if correction is None:
        return [inverse]
    axes = sampling.axes
    subtracted = sampled_correction(replace(correction, b1=0.0), after, sampling, stage.slope_of_curves(axes))
    solution: list[Stage] = [Parallel(((inverse,), (inverse_rate_correction(stage, correction, axes),)))]
    for _ in range(passes):
        solution = [Parallel(((Gain(1.0),), (*solution, subtracted, Gain(-1.0)))), inverse]
    return [*constant_removed(correction, axes), *solution]


def sampled_correction(correction: RateCorrection, after: Sequence[Stage], sampling: Sampling, slope: Array) -> StateSpace:
    """Ψ as the sampled plant shows it, below a `slope`: (Ψ G)(z) / G(z), both discretized exactly for the held command.

    Between two samples Ψ's output is not held as H_S's is: a lag much faster than the sample time is a pulse behind every step of the
    command. The ratio has a pole for every zero of G(z). Where one of them cannot be inverted, a longer numerator stands for it, by least
    squares on the answer of G to a step of the command.
    """
    linear = [stage for stage in after if isinstance(stage, (LinearStage, Delay))]
    axes = sampling.axes
    k1, k2, b2 = per_axis_scalars(correction, axes, "k1", "k2", "b2")
    # Ψ = (k1/k2) (1 - L), L = b2 / (k2 s + b2), so that only systems with a static gain are sampled.
    low_pass = TransferFunction([[b] for b in b2], [[k, b] for k, b in zip(k2, b2)])
    z = np.exp(1j * np.pi * (np.arange(LINES) + 0.5) / LINES)
    parts = []
    for axis, (g, lg) in enumerate(zip(sampled_systems(linear, sampling), sampled_systems([low_pass, *linear], sampling))):
        size = np.abs(g.zeros)
        inverted_zeros = g.zeros[(size < 1.0 - 1e-9) & ((g.zeros.real >= 0.0) | (size <= RINGING_LIMIT))]
        short = np.poly([np.exp(-b2[axis] / k2[axis] * sampling.sample_time), *inverted_zeros]).real
        den = np.append(short, np.zeros(TAPS))
        back = z[:, None] ** -np.arange(len(den))
        columns, goal = back * (g.response(z) / (back @ den) / (z - 1.0))[:, None], lg.response(z) / (z - 1.0)
        lag = np.linalg.lstsq(np.vstack([columns.real, columns.imag]), np.concatenate([goal.real, goal.imag]), rcond=1e-13)[0]
        num = k1[axis] / k2[axis] * (den - lag * den.sum() / lag.sum())
        largest = float(np.max(np.abs((back @ num) / (back @ den)))) / slope[axis]
        if largest >= 1.0:
            raise InputError(
                f"k1: the passes of mhl_inverse do not converge: at this sample time the rate correction is {largest:.3g} times the mean "
                "slope at most: take kind mhl"
            )
        states = len(den) - 1
        a = np.eye(states, k=-1)
        a[0] = -den[1:]
        parts.append((a, np.eye(states, 1), (num[1:] - num[0] * den[1:])[None], num[:1, None]))
    a, b, c, d = (block_diag(*(part[i] for part in parts)).tolist() for i in range(4))
    return StateSpace(a, b, c, d, sample_time=float(sampling.sample_time))
