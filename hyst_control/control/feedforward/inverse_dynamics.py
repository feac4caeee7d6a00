# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stable inverses of linear dynamics: ZPETC, ZMETC and NPZ-ignore, for any proper stable system at any sample time.

With G(z) = B_s(z) B_u(z) / A(z), B_u holding the zeros that cannot be inverted (nu of them, with gain one in the leading
power), the inverse of HAMPI paper Eq. 8 is

    G_inverse(z) = A(z) B_u*(z) / B_s(z)

    npz_ignore   B_u* = 1 / B_u(1)              gain wrong, phase wrong, shortest
    zpetc        B_u* = B_u(1/z) / B_u(1)^2     no phase error at any frequency
    zmetc        B_u* = 1 / B_u(1/z)            no magnitude error at any frequency (zeros outside the unit circle)

after Butterworth, Pao and Abramovitch, "Analysis and comparison of three discrete-time feedforward model-inverse control
techniques for nonminimum-phase systems", Mechatronics 22 (2012) (the right-hand column of the HAMPI paper's Table 3 is shifted
by one row). All three look `relative degree + nu` samples ahead, their *preview*; delayed by it they are ordinary filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigvals

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import Delay, LinearFilter, LinearStage, StateSpace, linear_filter
from hyst_control.chain.linear.symmetric_filter import flat_weights, weighted_sum
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.stage import Sampling, Stage

METHODS = ("zpetc", "zmetc", "npz_ignore")
DISCRETISATIONS = ("zoh", "tustin")
RINGING_LIMIT = 0.8
"""Size above which a zero in the left half of the unit disc is not inverted. Its inverse alternates in sign from sample to
sample; at 0.8 that ringing is down to 1 % after 21 samples, beyond it the drive is worn and the noise of a reference amplified."""
CIRCLE, MOST_GAIN = 512, 2.0
"""Frequencies at which the gain of zpetc is looked at, and the gain above which it is not restored: it would change its sign."""
INFINITE_ZERO = 1e4
"""A zero farther out than this is a delay of one sample: the difference is below 1e-4 in gain and phase at every frequency."""


@dataclass(frozen=True)
class DiscreteSystem:
    """gain · prod(z - zeros) / prod(z - poles), single input and output; poles (n,), zeros (m,), m <= n."""

    zeros: Complex
    poles: Complex
    gain: float

    def response(self, z: Complex) -> Complex:
        """Frequency response at points z of the complex plane."""
        z = np.asarray(z, dtype=complex)[..., None]
        return np.asarray(self.gain * np.prod(z - self.zeros, axis=-1) / np.prod(z - self.poles, axis=-1))


@dataclass(frozen=True)
class InverseDynamics:
    """An inverse delayed by `preview` samples as a filter of its own, per axis, and as stages for all axes."""

    stages: tuple[Stage, ...]
    preview: int
    systems: tuple[DiscreteSystem, ...]


def invert_dynamics(
    run: Sequence[Stage],
    sampling: Sampling,
    method: str = "zpetc",
    discretisation: str = "zoh",
    restored: bool = False,
) -> InverseDynamics:
    """Invert a run of linear stages and delays, from the held input to the sample of the output.

    `zoh` inverts the system exactly as it is sampled: input[k] held from t_k to t_k+1 (or interpolated, by `sampling.hold`),
    fractional delays included, output taken at t_k before input[k] acts. `tustin` is the HAMPI paper's choice: the bilinear
    transform of the continuous system, its delay rounded to whole samples. `restored`: see `invert_system`.
    """
    if method not in METHODS:
        raise InputError(f"inverse: {method!r} is not one of {', '.join(METHODS)}")
    if discretisation not in DISCRETISATIONS:
        raise InputError(f"discretisation: {discretisation!r} is not one of {', '.join(DISCRETISATIONS)}")
    plants = sampled_systems(run, sampling) if discretisation == "zoh" else tustin_systems(run, sampling)
    inverses = [invert_system(plant, method, restored) for plant in plants]
    preview = max(ahead for _, ahead in inverses)
    # Axes that look less far ahead are delayed to the longest, so that one preview holds for all.
    systems = tuple(
        DiscreteSystem(inverse.zeros, np.append(inverse.poles, np.zeros(preview - ahead)), inverse.gain)
        for inverse, ahead in inverses
    )
    late = [(preview - ahead) * sampling.sample_time for _, ahead in inverses]
    stage = discrete_stage([inverse for inverse, _ in inverses], sampling.sample_time)
    return InverseDynamics((Delay(late), stage) if any(late) else (stage,), preview, systems)


def invert_system(plant: DiscreteSystem, method: str, restored: bool = False) -> tuple[DiscreteSystem, int]:
    """Invert one system; see the module.

    The gain of zpetc is H = |B_u|² / B_u(1)². `restored` looks `nu` samples further ahead and multiplies it by 2 - H, where H is nowhere
    above 2: what is left of the gain's error is its square (Torfs, De Schutter and Swevers, "Extended bandwidth zero phase error
    tracking control of nonminimal phase systems", ASME J. Dyn. Syst. Meas. Control 114, 1992).
    """
    if np.any(np.abs(plant.poles) >= 1.0):
        worst = plant.poles[np.argmax(np.abs(plant.poles))]
        raise InputError(f"dynamics: not stable, a pole at |z| = {abs(worst):.6g}: no feedforward inverts that; correct the model")
    size = np.abs(plant.zeros)
    uninvertible = (size >= 1.0 - 1e-9) | ((plant.zeros.real < 0.0) & (size > RINGING_LIMIT))
    kept, left = plant.zeros[~uninvertible], plant.zeros[uninvertible]
    if np.any(np.abs(left - 1.0) < 1e-9):
        raise InputError("dynamics: no static gain (a zero at s = 0): no constant command holds a position; correct the model")
    preview = len(plant.poles) - len(plant.zeros) + len(left)
    # Zeros on the circle, or inside it but ringing, have no stable all-pass counterpart: zmetc takes zpetc's factor for them.
    outside = np.abs(left) > 1.0 + 1e-6
    zeros, poles, gain = plant.poles, kept, 1.0 / plant.gain
    for part, factor in ((left[outside], method), (left[~outside], "zpetc" if method == "zmetc" else method)):
        static, count = float(np.prod(1.0 - part).real), len(part)
        # B_u(1/z) = z^-count prod(-z_i) prod(z - 1/z_i)
        mirrored, lead = 1.0 / part, float(np.prod(-part).real)
        if factor == "zpetc":
            zeros, poles = np.concatenate([zeros, mirrored]), np.concatenate([poles, np.zeros(count)])
            gain *= lead / static**2
        elif factor == "zmetc":
            zeros, poles = np.concatenate([zeros, np.zeros(count)]), np.concatenate([poles, mirrored])
            gain /= lead
        else:
            gain /= static
    poles = np.concatenate([poles, np.zeros(preview)])
    if restored and method == "zpetc" and len(left):
        uninverted = np.poly(left).real / np.prod(1.0 - left).real
        on_circle = np.polyval(uninverted, np.exp(1j * np.linspace(0.0, np.pi, CIRCLE)))
        if np.max(np.abs(on_circle)) ** 2 <= MOST_GAIN:
            rest = -np.convolve(uninverted, uninverted[::-1])
            rest[len(left)] += 2.0
            zeros, poles = np.concatenate([zeros, np.roots(rest)]), np.concatenate([poles, np.zeros(2 * len(left))])
            return DiscreteSystem(zeros, poles, gain * float(rest[0])), preview + len(left)
    return DiscreteSystem(zeros, poles, gain), preview


def sampled_systems(run: Sequence[Stage], sampling: Sampling) -> list[DiscreteSystem]:
    """Exact sampled systems, per axis, from input[k] to the output sample at t_k."""
    running = linear_filter(_decoupled(run, sampling.axes), sampling)
    systems = []
    for axis in range(sampling.axes):
        a, b, c, d = _shift_form(running, axis)
        plant = _zero_pole_gain(a, b, c, d)
        # Under zoh the filter's output is the sample at the end of the interval; the plant's sample k is the end of interval k - 1.
        late = int(running.whole[axis]) + (1 if sampling.hold == "zoh" else 0)
        systems.append(DiscreteSystem(plant.zeros, np.append(plant.poles, np.zeros(late)), plant.gain))
    return systems


def tustin_systems(run: Sequence[Stage], sampling: Sampling) -> list[DiscreteSystem]:
    """Bilinear transforms, per axis, of linear stages; their delays rounded to whole samples."""
    ts = sampling.sample_time
    late = np.zeros(sampling.axes)
    systems = [DiscreteSystem(np.zeros(0, complex), np.zeros(0, complex), 1.0)] * sampling.axes
    for stage in _decoupled(run, sampling.axes):
        if isinstance(stage, Delay):
            late += np.broadcast_to(np.array(stage.tau, dtype=float), sampling.axes)
            continue
        assert isinstance(stage, LinearStage)
        for axis, system in enumerate(stage.systems(sampling.axes)):
            n = len(system.A)
            solve = np.linalg.inv(np.eye(n) - 0.5 * ts * system.A)
            plant = _zero_pole_gain(
                solve @ (np.eye(n) + 0.5 * ts * system.A),
                ts * solve @ system.B,
                system.C @ solve,
                system.D + 0.5 * ts * system.C @ solve @ system.B,
            )
            one = systems[axis]
            systems[axis] = DiscreteSystem(
                np.append(one.zeros, plant.zeros), np.append(one.poles, plant.poles), one.gain * plant.gain
            )
    whole = np.rint(late / ts).astype(int)
    return [DiscreteSystem(one.zeros, np.append(one.poles, np.zeros(whole[axis])), one.gain) for axis, one in enumerate(systems)]


def discrete_stage(systems: Sequence[DiscreteSystem], sample_time: float) -> Stage:
    """Digital filters side by side as one stage; realized in second-order sections, which keep slow poles exact."""
    parts = [_state_space(system) for system in systems]
    a, b, c, d = (block_diag(*(part[i] for part in parts)) for i in range(4))
    if not len(a):
        return Gain(np.diag(d).tolist())
    return StateSpace(a.tolist(), b.tolist(), c.tolist(), d.tolist(), sample_time=float(sample_time))


def zero_phase_low_pass(order: int, axes: int, sample_time: float) -> StateSpace:
    """`flat_weights` without phase, delayed by `order` samples, the same for every axis.

    It removes from a reference what jumps and kinks ask for near half the sampling rate, where a sampled model knows least.
    """
    return weighted_sum(flat_weights(order), axes, sample_time)


def _decoupled(run: Sequence[Stage], axes: int) -> list[Stage]:
    for stage in run:
        if (axes > 1 and stage.mixes_axes) or not (stage.linear or isinstance(stage, Delay)):
            raise InputError(
                f"chain ({stage.name}): a per-axis inverse needs continuous dynamics that do not mix the axes: "
                "use the lifted inverse of the whole chain"
            )
    return list(run)


def _shift_form(running: LinearFilter, axis: int) -> tuple[Array, Array, Array, Array]:
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k] of one axis of a running filter, without its whole-sample delay."""
    n = running.a.shape[1]
    taps, through = running.b[axis, :, :, 0], running.d[axis, :, 0, 0]
    a, b = np.zeros((n + 2, n + 2)), np.zeros((n + 2, 1))
    a[:n, :n] = running.a[axis]
    a[:n, n], a[:n, n + 1] = taps[1], taps[2]
    a[n + 1, n] = 1.0
    b[:n, 0], b[n, 0] = taps[0], 1.0
    # The filter's output uses the state after its update: y[k] = C x[k] with x[k] on the left of the update.
    c = np.zeros((1, n + 2))
    c[0] = running.c[axis, 0] @ a[:n]
    c[0, n] += through[1]
    d = np.array([[running.c[axis, 0] @ taps[0] + through[0]]])
    used = np.ones(n + 2, dtype=bool)
    used[n + 1] = bool(np.any(taps[2]))
    used[n] = used[n + 1] or bool(np.any(taps[1])) or through[1] != 0.0
    used[:n] = np.any(running.a[axis] != 0.0, axis=1) | np.any(taps != 0.0, axis=0)
    return a[np.ix_(used, used)], b[used], c[:, used], d


def _zero_pole_gain(a: Array, b: Array, c: Array, d: Array) -> DiscreteSystem:
    """Zeros (by the pencil of the system matrix, accurate for clustered poles), poles and gain from the response at rest."""
    n = len(a)
    poles = np.asarray(np.linalg.eigvals(a) if n else np.zeros(0), dtype=complex)
    rest = np.linalg.solve(np.eye(n) - a, b)
    static = float((c @ rest + d)[0, 0])
    if abs(static) <= 1e-9 * float((np.abs(c) @ np.abs(rest) + np.abs(d))[0, 0]):
        raise InputError("dynamics: no static gain: no constant command holds a position; correct the model")
    pencil = np.block([[a, b], [c, d]])
    alpha, beta = eigvals(pencil, block_diag(np.eye(n), np.zeros((1, 1))), homogeneous_eigvals=True)
    finite = np.abs(beta) * INFINITE_ZERO > np.abs(alpha)
    zeros = _conjugated(alpha[finite] / beta[finite])
    poles = _conjugated(poles)
    gain = float(static * np.prod(1.0 - poles).real / np.prod(1.0 - zeros).real)
    return DiscreteSystem(zeros, poles, gain)


def _conjugated(roots: Complex) -> Complex:
    """Roots of a real system with the pairs exactly conjugate."""
    roots = np.asarray(roots, dtype=complex)
    real = np.abs(roots.imag) <= 1e-10 * np.maximum(np.abs(roots), 1e-300)
    upper = roots[~real & (roots.imag > 0)]
    return np.concatenate([roots[real].real.astype(complex), upper, upper.conj()])


def _state_space(system: DiscreteSystem) -> tuple[Array, Array, Array, Array]:
    """A biproper discrete system as its second-order sections in series, without poles and zeros at the origin that cancel."""
    delays = min(np.count_nonzero(system.zeros == 0.0), np.count_nonzero(system.poles == 0.0))
    if delays:  # of a plant that is late by many samples, which its preview makes up for
        zeros, poles = (
            np.append(roots[roots != 0.0], np.zeros(np.count_nonzero(roots == 0.0) - delays))
            for roots in (system.zeros, system.poles)
        )
        system = DiscreteSystem(zeros, poles, system.gain)
    if not len(system.poles):
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[system.gain]])
    padding = np.zeros(len(system.poles) - len(system.zeros))
    if len(padding):
        # zpk2sos reads missing zeros as zeros at the origin, which is a sample's advance: delay by a state each instead.
        inner = DiscreteSystem(system.zeros, system.poles[: len(system.zeros)], system.gain)
        parts = [_state_space(inner), *[(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))] * len(padding)]
    else:
        from scipy.signal import zpk2sos  # here, not above: it takes longer to import than all that a node needs

        sections = zpk2sos(system.zeros, system.poles, system.gain)
        parts = [
            (np.array([[-a1, -a2], [1.0, 0.0]]), np.eye(2, 1), np.array([[b1 - a1 * b0, b2 - a2 * b0]]), np.array([[b0]]))
            for b0, b1, b2, _, a1, a2 in sections
        ]
    a, b, c, d = parts[0]
    for fa, fb, fc, fd in parts[1:]:
        a, b = np.block([[a, np.zeros((len(a), len(fa)))], [fb @ c, fa]]), np.vstack([b, fb @ d])
        c, d = np.hstack([fd @ c, fc]), fd @ d
    return a, b, c, d
