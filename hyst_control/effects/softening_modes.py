# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modes that soften with amplitude."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numba import njit
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array, Complex, Integers
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.c_code.c_code import COMPLEX, LARGER, CCode, integers, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear.linear_stages import LinearStage, LinearSystem, TransferFunction
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, VectorPerAxis, scalar, vector
from hyst_control.chain.stage import Filter, Modifier, Sampling, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.modifiers import beside_mechanics

C = c_texts(__file__)

MEMORY = 0.1  # s, over which the amplitude is averaged
DEFECTIVE = 1e9  # Condition of the eigenvectors beyond which a system has no modes of its own: its poles coincide


@register
@dataclass(frozen=True)
class SofteningModes(Modifier):
    """Lets the modes of the mechanics G before it move with the slow amplitude a of the motion; G is theirs at rest.

    a (measurement unit) is the root of the mean square about the slow mean of the static deflection G(0) u, averaged over
    0.1 s; where the mechanics couple the axes, over these too. With r = sqrt(a / amplitude) every pole λ of G becomes

        λ(a) = Re λ (1 + damping r) + j Im λ (1 - softening r),    static deflection of each mode kept.

    The square root is the law of a restoring force q |q|^0.5 that loses stiffness (measured on a mirror, see
    `chain.softening_modal`). `softening` and `damping` are shares at the amplitude `amplitude`,
    common to all modes. Where the modes differ, `softening_factors` and `damping_factors` hold the factor of every mode on the common
    value, a pair of conjugate poles or a real pole each, in order of |λ|; a single factor holds for all.
    """

    name: ClassVar[str] = "softening_modes"
    equation: ClassVar[str] = (
        r"\lambda(a) = \mathrm{Re}\, \lambda \left(1 + \mathrm{damping}\, r\right) + j\, \mathrm{Im}\, \lambda \left(1 - "
        r"\mathrm{softening}\, r\right), \quad r = \sqrt{\frac{a}{\mathrm{amplitude}}}"
    )
    place: ClassVar[str] = "motion"
    softening: ScalarPerAxis = scalar("", "share of the frequencies that is lost at the amplitude")
    damping: ScalarPerAxis = scalar("", "share by which the damping grows at the amplitude")
    amplitude: ScalarPerAxis = scalar("measurement unit", "of the motion", above=0.0)
    softening_factors: VectorPerAxis = vector(
        "", "of every mode on the softening, in order of |λ|; one: of all", default=(1.0,), scatter=Scattering.NONE
    )
    damping_factors: VectorPerAxis = vector(
        "", "of every mode on the damping, in order of |λ|; one: of all", default=(1.0,), scatter=Scattering.NONE
    )

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        softening, damping, amplitude = per_axis_scalars(self, axes, "softening", "damping", "amplitude")
        if not softening.any() and not damping.any():
            return before
        factors = [self.declarations()[name].spread(getattr(self, name), axes) for name in ("softening_factors", "damping_factors")]
        # A mode each, where they differ: a simulation of another value then runs the mode again that it is of.
        lengths = {(len(one), len(other)) for one, other in zip(*factors, strict=True)}
        counts = set(lengths.pop()) - {1} if len(lengths) == 1 else set()
        modes = counts.pop() if len(counts) == 1 else 1

        def moved(mechanics: LinearStage) -> Stage:
            all_modes = ModesMoved(mechanics, tuple(softening), tuple(damping), tuple(amplitude), *factors)
            return Parallel(tuple((all_modes.of_mode(mode, modes),) for mode in range(modes))) if modes > 1 else all_modes

        return beside_mechanics(self.name, before, moved)


@dataclass(frozen=True)
class ModesMoved(Stage):
    """Part that moving modes add to the response of a linear stage; values per axis. Part of a started chain only."""

    base: LinearStage
    softening: tuple[float, ...]
    damping: tuple[float, ...]
    amplitude: tuple[float, ...]
    softening_factors: tuple[tuple[float, ...], ...]
    damping_factors: tuple[tuple[float, ...], ...]
    mode: int | None = None  # The only one that it is of, in order of |λ|; None: all
    modes: int = 0  # Number of modes that there have to be; 0: any

    def of_mode(self, mode: int, modes: int) -> ModesMoved:
        """The part of one mode, with no number of any other."""

        def own(common: tuple[float, ...], factors: tuple[tuple[float, ...], ...]) -> tuple[float, ...]:
            return tuple(share * float(of[min(mode, len(of) - 1)]) for share, of in zip(common, factors, strict=True))

        alike = ((1.0,),) * len(self.softening)
        softening, damping = own(self.softening, self.softening_factors), own(self.damping, self.damping_factors)
        return ModesMoved(self.base, softening, damping, self.amplitude, alike, alike, mode, modes)

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (TransferFunction([0.0], [1.0]),)

    def filter(self, sampling: Sampling) -> Filter:
        systems = self.base.systems(sampling.axes)
        values = zip(self.softening, self.damping, self.amplitude, self.softening_factors, self.damping_factors)
        if len(systems) == 1 and sampling.axes > 1 and len(set(values)) > 1:
            raise InputError("softening_modes: a list with one value per axis, but coupled axes share their modes: give one number")
        return ModesMovedFilter(systems, self, sampling)


class ModesMovedFilter(Filter):
    """Streaming `ModesMoved`: every mode run twice, moved and as it is, and subtracted."""

    hold = "foh"

    def __init__(self, systems: list[LinearSystem], stage: ModesMoved, sampling: Sampling) -> None:
        poles, shares = [], []
        for axis, (own, entering, leaving, _) in enumerate(map(modal, systems)):
            if stage.modes not in (0, len(own)):
                raise InputError(f"softening_modes: {stage.modes} factors for {len(own)} modes: give one, or one per mode")
            softening = stage.softening[axis] * by_mode("softening_factors", stage.softening_factors[axis], len(own))
            damping = stage.damping[axis] * by_mode("damping_factors", stage.damping_factors[axis], len(own))
            chosen = slice(None) if stage.mode is None else slice(stage.mode, stage.mode + 1)
            poles.append((own[chosen], np.stack([softening, damping], axis=1)[chosen]))
            shares.append((entering[chosen], leaving[:, chosen]))
        self.poles = np.concatenate([own for own, _ in poles])
        self.change = np.ascontiguousarray(np.concatenate([moved for _, moved in poles]))
        self.inputs, self.outputs = block_diag(*(b for b, _ in shares)), block_diag(*(c for _, c in shares))
        self.static = np.ascontiguousarray(block_diag(*(modal(one)[3] for one in systems)) / np.array(stage.amplitude)[:, None])
        self.step, self.smooth = sampling.sample_time, 1.0 - np.exp(-sampling.sample_time / MEMORY)
        self.held = sampling.hold == "zoh"
        self.state = np.zeros((2, len(self.poles)), dtype=complex)
        self.mean, self.square, self.last = np.zeros(sampling.axes), np.zeros(len(systems)), np.full(sampling.axes, np.nan)
        self.whose = np.repeat(np.arange(len(systems)), [len(own) for own, _ in poles])

    def settle(self, value: Array) -> Array:
        value = np.array(value, dtype=float)
        self.square[:] = 0.0
        settle_modes_moved(value, self.poles, self.inputs, self.static, self.mean, self.state)
        self.last[:] = np.nan if self.held else value
        return np.zeros(len(value))

    def process(self, block: Array) -> Array:
        output, system = np.empty_like(block), (self.poles, self.inputs, self.outputs, self.static)
        memory = self.last, self.mean, self.square, self.state
        advance_modes_moved(block, self.step, self.smooth, system, self.change, self.whose, memory, output)
        return output

    def c_code(self) -> CCode:
        def pairs(values: Complex) -> Array:
            return np.stack([np.real(values), np.imag(values)], axis=-1)

        return CCode(
            "softening modes",
            C["ADVANCE"],
            C["COME_TO_REST"],
            {
                "MODES": len(self.poles),
                "SQUARES": len(self.square),
                "SHARED": len(self.last) // len(self.square),
                "HELD": int(self.held),
            },
            {
                "poles": reals(pairs(self.poles), "1/s, complex"),
                "as_it_is": reals(pairs(np.array([_carried(pole, self.step) for pole in self.poles])), "of a step, complex"),
                "change": reals(self.change, "softening and damping of every mode"),
                "inputs": reals(pairs(self.inputs), "[mode][input], complex"),
                "outputs": reals(pairs(self.outputs), "[output][mode], complex"),
                "statics": reals(self.static, "of the motion's amplitude / input unit"),
                "smooth": reals(self.smooth, "share by which the means follow in a step"),
                "time": reals(self.step, "s, of a step"),
                "whose": integers(self.whose, "square that the mode goes by"),
            },
            {
                "x": reals(pairs(self.state), "modes as they are, and moved; complex"),
                "mean": reals(self.mean, "in units of the amplitude"),
                "square": reals(self.square, "about the mean"),
                "last": reals(self.last, "input before"),
            },
            (LARGER, COMPLEX, C["PAIR"]),
        )


@remembered
def modal(system: LinearSystem) -> tuple[Complex, Complex, Complex, Array]:
    """Decompose a system into its modes: y = D u + Re Σ c x, dx/dt = λ x + b u."""
    own, vectors = np.linalg.eig(system.A)
    if len(own) and not np.linalg.cond(vectors) < DEFECTIVE:
        raise InputError("softening_modes: the mechanics' poles coincide, they have no modes of their own: separate them a little")
    entering = np.linalg.solve(vectors, system.B.astype(complex)) if len(own) else system.B.astype(complex)
    one = np.flatnonzero(own.imag >= 0.0)  # of every conjugate pair, whose sum is twice the real part
    one = one[np.argsort(np.abs(own[one]), kind="stable")]
    leaving = (system.C @ vectors)[:, one] * np.where(own[one].imag > 0.0, 2.0, 1.0)
    return own[one].astype(complex), entering[one], leaving.astype(complex), system.static_gain()


def by_mode(name: str, factors: tuple[float, ...], modes: int) -> Annotated[Array, "M"]:
    """Factors of all modes, in order of |λ|."""
    if len(factors) not in (1, modes):
        raise InputError(f"softening_modes: {name}: {len(factors)} factors for {modes} modes: give one, or one per mode")
    return np.broadcast_to(np.array(factors, dtype=float), modes)


@njit(cache=True)
def _carried(pole: complex, step: float) -> Any:
    return np.exp(pole * step)


@njit(cache=True)
def settle_modes_moved(
    value: Annotated[Array, "A"], poles: Complex, inputs: Complex, static: Array, mean: Array, state: Complex
) -> None:
    """Bring the modes to rest at a constant input."""
    for o in range(len(value)):
        mean[o] = 0.0
        for j in range(len(value)):
            mean[o] += static[o, j] * value[j]
    for i in range(len(poles)):
        entering = 0j
        for j in range(len(value)):
            entering += inputs[i, j] * value[j]
        state[0, i] = -entering / poles[i]
        state[1, i] = state[0, i]


@njit(cache=True)
def advance_modes_moved(
    block: Annotated[Array, "N A"],
    step: float,
    smooth: float,
    system: tuple[Complex, Complex, Complex, Array],
    change: Annotated[Array, "M"],
    whose: Integers,
    memory: tuple[Array, Array, Array, Complex],
    output: Annotated[Array, "N A"],
) -> None:
    """Run the equations of `SofteningModes` over a block."""
    (poles, inputs, outputs, static), (last, mean, square, state) = system, memory
    modes, axes, shared = len(poles), block.shape[1], block.shape[1] // len(square)
    held = np.isnan(last[0])
    drive, roots = np.empty(axes), np.empty(len(square))
    as_it_is = np.exp(poles * step)
    for row in range(block.shape[0]):
        for j in range(axes):
            drive[j] = block[row, j] if held else 0.5 * (block[row, j] + last[j])
            if not held:
                last[j] = block[row, j]
        for s in range(len(square)):
            power = 0.0
            for o in range(s * shared, (s + 1) * shared):
                deflection = 0.0
                for j in range(axes):
                    deflection += static[o, j] * drive[j]
                power += (deflection - mean[o]) ** 2
                mean[o] += smooth * (deflection - mean[o])
            square[s] += smooth * (power / shared - square[s])
            roots[s] = square[s] ** 0.25
        for o in range(axes):
            output[row, o] = 0.0
        for i in range(modes):
            entering = 0j
            for j in range(axes):
                entering += inputs[i, j] * drive[j]
            rest, root = -entering / poles[i], roots[whose[i]]
            pole = complex(poles[i].real * max(1.0 + change[i, 1] * root, 0.0), poles[i].imag * (1.0 - change[i, 0] * root))
            state[0, i] = rest + as_it_is[i] * (state[0, i] - rest)
            state[1, i] = rest + np.exp(pole * step) * (state[1, i] - rest)
            for o in range(axes):
                output[row, o] += (outputs[o, i] * (state[1, i] - state[0, i])).real


SOFTENING = "softening"
DAMPING = "damping"


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Softening and damping of all modes alike, in a record's surroundings `around`."""
    return (Parameter(SOFTENING, "", 0.0, (0.002,), -0.2, 0.2, 0.02), Parameter(DAMPING, "", 0.0, (0.0,), -0.9, 5.0, 0.5))


def coupled_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Of coupled axes: every mode that oscillates softens by a share of its own."""
    if not around.poles:
        return parameters(around)
    return tuple(
        replace(parameter, name=f"{parameter.name}_{mode}", starts=(0.0,), told=False)
        for parameter in parameters(around)
        for mode, pole in enumerate(around.poles)
        if pole.imag
    )


def _by_mode(values: Values, name: str) -> Array:
    """The shares of a parameter by mode, as far as a mode has one."""
    return np.array([value for key, value in values.items() if key.startswith(f"{name}_")])


def common(values: Values) -> dict[str, float]:
    """Median of the modes' shares; where that is 0 because few have any, their mean size."""
    found = {}
    for name in (SOFTENING, DAMPING):
        shares = _by_mode(values, name)
        if len(shares):
            found[name] = float(np.median(shares) or np.mean(np.abs(shares)))
    return found


def stage(values: Values, around: Surroundings) -> Stage:
    """Modes that soften alike, or each by its own share."""
    factors = {
        name: tuple(values.get(f"{name}_{mode}", 0.0) / (values[name] or 1.0) for mode in range(len(around.poles)))
        for name in (SOFTENING, DAMPING)
        if len(_by_mode(values, name))
    }
    each = (factors.get(name, (1.0,)) for name in (SOFTENING, DAMPING))
    return SofteningModes(values[SOFTENING], values[DAMPING], max(0.25 * around.stroke, 1e-300), *each)


EFFECT = Effect(
    "softening_modes",
    "motion",
    "The modes soften with amplitude: their frequencies fall and their damping grows with the root of it.",
    parameters,
    stage,
    shared=True,
    coupled_parameters=coupled_parameters,
    summary=common,
    phrase="modes that soften with amplitude",
)
