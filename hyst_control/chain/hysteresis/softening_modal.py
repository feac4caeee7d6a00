# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modes that soften with amplitude: a structure on piezo actuators whose stiffness and gain depend on how hard it is driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import COMPLEX, CCode, reals
from hyst_control.chain.c_code.texts import c_filled, c_texts
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.chain.parameter import AllAxes, Scattering, all_axes
from hyst_control.chain.stage import Filter, Role, Sampling, Stage, register

C = c_texts(__file__)


@register
@dataclass(frozen=True)
class SofteningModal(Stage):
    """Coupled modes, scheduled by the slow amplitude of the command, with a softening force of the elongation.

    The slow amplitude a (V) is the root of the mean square over the axes of the command, low-passed over `memory` (s),
    and

        g  = (sqrt(a / amplitude) - 1) / (1 - sqrt(1/2))          0 at `amplitude`, -1 at half of it
        λ_i = -exp(decay_i + decay_change_i g) + j (frequency_i + frequency_change_i g)
        dx_i/dt = λ_i x_i + (inputs_i + inputs_change_i g) · u,   z = 2 Re Σ c_i x_i + feedthrough u
        n  = q (|q|^exponent - force_mean a^exponent),  q = elongation z         per actuator and exponent
        s  = stop(u) - stop_mean u,   stop(u): u since its last reversal, no further than ±stop_threshold    per actuator and threshold
        p  = q_j q_k - product_mean a²                                                 per pair of actuators, j ≤ k
        dw_i/dt = λ_i w_i + force_inputs_i · n + stop_inputs_i · s + product_inputs_i · p
        y  = z + 2 Re Σ c_i w_i + force_feedthrough n + stop_feedthrough s + product_feedthrough p

    The first part is the structure as it responds on the average at this amplitude (its describing function); n is
    what the softening force q |q|^exponent has beyond that average from one instant to the next. n is sampled and held.
    Several exponents are several terms of one force, each with gains of its own. s is the hysteresis of the actuators, a stop operator
    of the command without its average part, which is in the first part already. p is the even part of the force: what stretching one
    actuator does to the stiffness that the others meet, and an actuator that pushes harder than it pulls. p is held as n is.

    Shapes for M modes and A axes: decay (log of 1/s), frequency (rad/s) and their changes (M); c = outputs (M, A),
    inputs and inputs_change (M, A) and force_inputs (M, K A) for K exponents, the terms one after the other, each as a
    pair [real, imaginary]; feedthrough (A, A), force_feedthrough (A, K A) and force_mean (K A); elongation (A, A), V per
    measurement unit, so that q is in volts of quasi-static command; exponent one number or K; stop_inputs (M, T A), stop_feedthrough
    (A, T A) and stop_mean (T A) for T stop thresholds in the same order; product_inputs (M, P), product_feedthrough (A, P) and
    product_mean (P) for the P = A (A + 1) / 2 pairs (1, 1), (1, 2) … (1, A), (2, 2) … A mode of frequency 0 is real and counts once.
    """

    name: ClassVar[str] = "softening_modal"
    ROLES: ClassVar[Role] = Role.MIXES_AXES | Role.HYSTERESIS
    decay: AllAxes = all_axes("log(1/s)", "of every mode", 1, scatter=Scattering.POLES)
    frequency: AllAxes = all_axes("rad/s", "of every mode; 0: a real one", 0, 1, scatter=Scattering.POLES)
    outputs: AllAxes = all_axes("measurement unit", "c, [real, imaginary] of (modes, axes)", 3)
    inputs: AllAxes = all_axes("1/(V s)", "b at the amplitude, [real, imaginary] of (modes, axes)", 0, 1, 2, 3)
    feedthrough: AllAxes = all_axes("measurement unit / V", "of the command, (axes, axes)", 0, 1, 2)
    amplitude: float = all_axes("V", "slow amplitude at which decay, frequency and inputs hold", 0, above=0.0)
    decay_change: AllAxes = all_axes("log(1/s)", "change of decay with g", 0, 1, default=0.0)
    frequency_change: AllAxes = all_axes("rad/s", "change of frequency with g", 0, 1, default=0.0)
    inputs_change: AllAxes = all_axes("1/(V s)", "change of inputs with g", 0, 1, 2, 3, default=0.0)
    elongation: AllAxes = all_axes("V / measurement unit", "of the softening force, (axes, axes)", 0, 1, 2, default=0.0)
    force_inputs: AllAxes = all_axes("1/(V s)", "of the force, as inputs, (modes, exponents · axes)", 0, 1, 2, 3, default=0.0)
    force_feedthrough: AllAxes = all_axes("measurement unit / V", "of the force", 0, 1, 2, default=0.0)
    force_mean: AllAxes = all_axes("", "average of the force, (exponents · axes)", 0, 1, default=0.0)
    exponent: AllAxes = all_axes("", "of the softening force, one or several", 0, 1, default=0.5, above=0.0)
    stop_threshold: AllAxes = all_axes("V", "of the command's stop operators, one or several", 0, 1, default=0.0, lower=0.0)
    stop_inputs: AllAxes = all_axes(
        "1/(V s)", "of the stop operators, as inputs, (modes, thresholds · axes)", 0, 1, 2, 3, default=0.0
    )
    stop_feedthrough: AllAxes = all_axes("measurement unit / V", "of the stop operators", 0, 1, 2, default=0.0)
    stop_mean: AllAxes = all_axes("", "average gain of the stop operators, (thresholds · axes)", 0, 1, default=0.0)
    product_inputs: AllAxes = all_axes("1/(V s)", "of the products, as inputs, (modes, pairs of axes)", 0, 1, 2, 3, default=0.0)
    product_feedthrough: AllAxes = all_axes("measurement unit / V", "of the products", 0, 1, 2, default=0.0)
    product_mean: AllAxes = all_axes("", "average of the products, (pairs of axes)", 0, 1, default=0.0)
    memory: float = all_axes("s", "over which the amplitude is averaged", 0, default=0.1, above=0.0)

    def check(self) -> None:
        self.arrays(self.axes)

    @property
    def axes(self) -> int:
        """Number of axes that the parameters are for."""
        outputs: Any = self.outputs
        return len(outputs[0][0])

    def arrays(self, axes: int) -> dict[str, np.ndarray]:
        """Every parameter as an array of its full shape, complex where it is a pair."""
        modes, terms, stops = int(np.size(self.decay)), axes * int(np.size(self.exponent)), axes * int(np.size(self.stop_threshold))
        products = axes * (axes + 1) // 2
        due: dict[str, tuple[int, ...]] = dict.fromkeys(("decay", "frequency", "decay_change", "frequency_change"), (modes,))
        due |= dict.fromkeys(("feedthrough", "elongation"), (axes, axes))
        due |= dict.fromkeys(("outputs", "inputs", "inputs_change"), (2, modes, axes))
        for force, count in (("force", terms), ("stop", stops), ("product", products)):
            due |= {f"{force}_inputs": (2, modes, count), f"{force}_feedthrough": (axes, count), f"{force}_mean": (count,)}
        arrays = {}
        for field, shape in due.items():
            try:
                value = np.broadcast_to(np.array(getattr(self, field), dtype=float), shape).copy()
            except ValueError:
                raise InputError(
                    f"{field}: shape {np.shape(getattr(self, field))}, give {shape} for {modes} modes and {axes} axes"
                ) from None
            arrays[field] = value[0] + 1j * value[1] if len(shape) == 3 else value
        return arrays

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (self.mean(),)

    def mean(self) -> StateSpace:
        """The structure as it responds on the average at `amplitude`: a linear stage."""
        parts = self.arrays(self.axes)
        blocks: list[Any] = []
        rows: list[Array] = []
        columns: list[Array] = []
        for i, (decay, frequency) in enumerate(zip(parts["decay"], parts["frequency"], strict=True)):
            b, c, rate = parts["inputs"][i], parts["outputs"][i], -np.exp(decay)
            if frequency == 0.0:
                blocks, rows, columns = [*blocks, [[rate]]], [*rows, b.real], [*columns, c.real]
            else:
                blocks.append([[rate, -frequency], [frequency, rate]])
                rows, columns = [*rows, b.real, b.imag], [*columns, 2 * c.real, -2 * c.imag]
        return StateSpace(block_diag(*blocks), np.array(rows), np.array(columns).T, parts["feedthrough"])

    def filter(self, sampling: Sampling) -> Filter:
        if self.axes != sampling.axes:
            raise InputError(f"outputs: for {self.axes} axes, the model has {sampling.axes}")
        return SofteningModalFilter(self, sampling)


class Numbers(NamedTuple):
    """The numbers of a `SofteningModal` as its kernels take them, for M modes and A axes."""

    # exponent, amplitude: (K,) of the softening force; V
    exponent: Annotated[Array, "K"]
    amplitude: float
    decay: Annotated[Array, "M"]
    frequency: Annotated[Array, "M"]
    decay_change: Annotated[Array, "M"]
    frequency_change: Annotated[Array, "M"]
    # c, b, b_change, d, k: Outputs (M, A), inputs and their change (M, A), feedthrough (A, A), elongation (A, A)
    c: Complex
    b: Complex
    b_change: Complex
    d: Annotated[Array, "M A"]
    k: Annotated[Array, "M A"]
    # h, h_d: Inputs (M, (K + T) A + P) and feedthrough (A, (K + T) A + P) of all forces
    h: Complex
    h_d: Array
    # force_mean, threshold, stop_mean, product_mean: (K A,): mean of n; (T,) and (T A,): of the stop operators; (P,): mean of p
    force_mean: Annotated[Array, "T"]
    threshold: Annotated[Array, "T"]
    stop_mean: Annotated[Array, "T"]
    product_mean: Annotated[Array, "T"]


class Memory(NamedTuple):
    """Memory of a `SofteningModal`, updated in place."""

    state: Complex  # (2, M) complex: x and w
    mean_square: Annotated[Array, "1"]  # (1,): a²
    force: Array  # ((K + T) A + P,): n of the tick that begins the interval, s of the interval, and p as n
    play: Array  # (T A,): command less what the stop operators hold


@njit(cache=True)
def softening_forces(
    linear: Annotated[Array, "A"], a: float, numbers: Numbers, strain: Annotated[Array, "A"], force: Annotated[Array, "A"]
) -> None:
    """Compute the forces that follow the elongation: n and p, each less its mean at the slow amplitude."""
    axes, exponent, force_mean, product_mean = len(strain), numbers.exponent, numbers.force_mean, numbers.product_mean
    for j in range(axes):
        q = 0.0
        for o in range(axes):
            q += numbers.k[j, o] * linear[o]
        for e in range(exponent.size):
            at = e * axes + j
            force[at] = q * (abs(q) ** exponent[e] - force_mean[at] * a ** exponent[e])
        strain[j] = q
    at = force_mean.size + numbers.stop_mean.size
    for j in range(axes):
        for e in range(j, axes):
            force[at] = strain[j] * strain[e] - product_mean[at - force_mean.size - numbers.stop_mean.size] * a * a
            at += 1


@njit(cache=True)
def softening_stops(command: Annotated[Array, "A"], numbers: Numbers, play: Array, force: Array) -> None:
    """Stop operators of a command, from the play that they had."""
    threshold, axes = numbers.threshold, command.size
    for e in range(threshold.size):
        for j in range(axes):
            at = e * axes + j
            play[at] = min(max(play[at], command[j] - threshold[e]), command[j] + threshold[e])
            force[numbers.force_mean.size + at] = (command[j] - play[at]) - numbers.stop_mean[at] * command[j]


@njit(cache=True)
def softening_pole(i: int, g: float, numbers: Numbers) -> complex:
    """Pole of a mode at a scheduled amplitude g; a real one of a mode that does not oscillate."""
    decay = -np.exp(numbers.decay[i] + numbers.decay_change[i] * g)
    if numbers.frequency[i] == 0.0:
        return complex(decay, 0.0)
    return complex(decay, numbers.frequency[i] + numbers.frequency_change[i] * g)


@njit(cache=True)
def advance_softening_modal(
    block: Annotated[Array, "N A"],
    smooth: float,
    step: float,
    last: Annotated[Array, "A"],
    numbers: Numbers,
    memory: Memory,
    output: Annotated[Array, "N A"],
) -> None:
    """Run the equations of `SofteningModal` over a block."""
    # last: (A,), command before, with which it is averaged for a sampled smooth source (`last[0]` NaN: a held command); updated
    c, b, b_change, d, h, h_d = numbers.c, numbers.b, numbers.b_change, numbers.d, numbers.h, numbers.h_d
    frequency, (state, mean_square, force, play) = numbers.frequency, memory
    modes, axes = c.shape
    held = np.isnan(last[0])
    drive, linear, strain = np.empty(axes), np.empty(axes), np.empty(axes)
    for row in range(block.shape[0]):
        power = 0.0
        for j in range(axes):
            drive[j] = block[row, j] if held else 0.5 * (block[row, j] + last[j])
            power += drive[j] ** 2
            if not held:
                last[j] = block[row, j]
        mean_square[0] += smooth * (power / axes - mean_square[0])
        a = np.sqrt(mean_square[0])
        g = (np.sqrt(a / numbers.amplitude) - 1.0) / (1.0 - np.sqrt(0.5))
        softening_stops(drive, numbers, play, force)
        for o in range(axes):
            linear[o] = 0.0
            output[row, o] = 0.0
            for j in range(axes):
                linear[o] += d[o, j] * drive[j]
            for j in range(force.size):
                output[row, o] += h_d[o, j] * force[j]
        for i in range(modes):
            pole = softening_pole(i, g, numbers)
            carry = np.exp(pole * step)
            gain = (carry - 1.0) / pole
            by_command, by_force = 0j, 0j
            for j in range(axes):
                by_command += (b[i, j] + b_change[i, j] * g) * drive[j]
            for j in range(force.size):
                by_force += h[i, j] * force[j]
            state[0, i] = carry * state[0, i] + gain * by_command
            state[1, i] = carry * state[1, i] + gain * by_force
            twice = 1.0 if frequency[i] == 0.0 else 2.0
            for o in range(axes):
                linear[o] += twice * (c[i, o] * state[0, i]).real
                output[row, o] += twice * (c[i, o] * state[1, i]).real
        for o in range(axes):
            output[row, o] += linear[o]
        softening_forces(linear, a, numbers, strain, force)


@njit(cache=True)
def settle_softening_modal(value: Annotated[Array, "A"], numbers: Numbers, memory: Memory, output: Annotated[Array, "A"]) -> None:
    """Bring `SofteningModal` to rest at a constant command."""
    c, b, b_change, d, h, h_d = numbers.c, numbers.b, numbers.b_change, numbers.d, numbers.h, numbers.h_d
    frequency, (state, mean_square, force, play) = numbers.frequency, memory
    modes, axes = c.shape
    power = 0.0
    for j in range(axes):
        power += value[j] ** 2
    mean_square[0] = power / axes
    a = np.sqrt(mean_square[0])
    g = (np.sqrt(a / numbers.amplitude) - 1.0) / (1.0 - np.sqrt(0.5))
    play[:] = 0.0
    softening_stops(value, numbers, play, force)
    linear, strain = np.empty(axes), np.empty(axes)
    for o in range(axes):
        linear[o] = 0.0
        for j in range(axes):
            linear[o] += d[o, j] * value[j]
    for i in range(modes):
        pole = softening_pole(i, g, numbers)
        entering = 0j
        for j in range(axes):
            entering += (b[i, j] + b_change[i, j] * g) * value[j]
        state[0, i] = -entering / pole
        twice = 1.0 if frequency[i] == 0.0 else 2.0
        for o in range(axes):
            linear[o] += twice * (c[i, o] * state[0, i]).real
    softening_forces(linear, a, numbers, strain, force)
    for o in range(axes):
        output[o] = linear[o]
        for j in range(force.size):
            output[o] += h_d[o, j] * force[j]
    for i in range(modes):
        pole = softening_pole(i, g, numbers)
        entering = 0j
        for j in range(force.size):
            entering += h[i, j] * force[j]
        state[1, i] = -entering / pole
        twice = 1.0 if frequency[i] == 0.0 else 2.0
        for o in range(axes):
            output[o] += twice * (c[i, o] * state[1, i]).real


class SofteningModalFilter(Filter):
    """Streaming `SofteningModal`."""

    hold = "foh"

    def __init__(self, stage: SofteningModal, sampling: Sampling) -> None:
        arrays = stage.arrays(sampling.axes)
        self.numbers = Numbers(
            exponent=np.atleast_1d(np.asarray(stage.exponent, dtype=float)),
            amplitude=stage.amplitude,
            **{name: arrays[name] for name in ("decay", "frequency", "decay_change", "frequency_change")},
            c=arrays["outputs"],
            b=arrays["inputs"],
            b_change=arrays["inputs_change"],
            d=arrays["feedthrough"],
            k=arrays["elongation"],
            h=np.concatenate([arrays["force_inputs"], arrays["stop_inputs"], arrays["product_inputs"]], axis=1),
            h_d=np.concatenate([arrays["force_feedthrough"], arrays["stop_feedthrough"], arrays["product_feedthrough"]], axis=1),
            threshold=np.atleast_1d(np.asarray(stage.stop_threshold, dtype=float)),
            **{name: arrays[name] for name in ("force_mean", "stop_mean", "product_mean")},
        )
        self.smooth, self.step = 1.0 - np.exp(-sampling.sample_time / stage.memory), sampling.sample_time
        self.held = sampling.hold == "zoh"
        modes = len(arrays["decay"])
        self.last = np.full(sampling.axes, np.nan)
        plays = arrays["stop_mean"].size
        forces = arrays["force_mean"].size + plays + arrays["product_mean"].size
        self.memory = Memory(np.zeros((2, modes), dtype=complex), np.zeros(1), np.zeros(forces), np.zeros(plays))

    def settle(self, value: Array) -> Array:
        value = np.array(value, dtype=float)
        settled = np.empty_like(value)
        self.last[:] = np.nan if self.held else value
        settle_softening_modal(value, self.numbers, self.memory, settled)
        return settled

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        advance_softening_modal(block, self.smooth, self.step, self.last, self.numbers, self.memory, output)
        return output

    def c_code(self) -> CCode:
        texts = (
            "log(1/s)",
            "rad/s",
            "log(1/s)",
            "rad/s",
            "measurement unit, complex",
            "1/(V s), complex",
            "1/(V s), complex",
            "measurement unit / V",
            "V / measurement unit",
            "1/(V s), complex",
            "measurement unit / V",
            "mean of the force",
            "V, of the stop operators",
            "mean of the stop operators",
            "mean of the products",
        )
        numbers, memory = self.numbers, self.memory
        names = Numbers._fields[2:]
        return CCode(
            "softening modal",
            c_filled(C["ADVANCE"], {"COMMAND": "drive", "PLAY": "s->play[at]"}),
            c_filled(C["COME_TO_REST"], {"COMMAND": "in", "PLAY": "R(0.0)"}),
            {
                "MODES": memory.state.shape[1],
                "FORCES": memory.force.size,
                "EXPONENTS": numbers.exponent.size,
                "THRESHOLDS": memory.play.size // len(self.last),
                "HELD": int(self.held),
            },
            {
                **{name: reals(_pairs(value), text) for name, value, text in zip(names, numbers[2:], texts, strict=True)},
                "exponent": reals(numbers.exponent, "of the softening force"),
                "amplitude": reals(numbers.amplitude, "V"),
                "smooth": reals(self.smooth, "share by which the mean square follows in a step"),
                "time": reals(self.step, "s, of a step"),
                "span": reals(1.0 - np.sqrt(0.5), "of the root of the amplitude where g falls by 1"),
            },
            {
                "x": reals(_pairs(memory.state), "modes driven by the command, and by the force; complex"),
                "mean_square": reals(0.0, "V^2"),
                "last": reals(self.last, "V, command before"),
                "force": reals(memory.force, "of the tick that begins the interval, with the stop operators and the products"),
                "play": reals(memory.play, "V, command less what the stop operators hold"),
            },
            (COMPLEX, C["MODES"]),
        )


def _pairs(values: Any) -> Array:
    """Complex numbers as pairs (..., 2); real ones unchanged."""
    return np.stack([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else np.asarray(values, dtype=float)
