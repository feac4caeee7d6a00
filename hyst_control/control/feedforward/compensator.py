# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Feedforward compensators built from a model: chains of stages from the reference to the command (docs/control.md has the kinds).

A compensator runs with hold `foh`: command[k] from reference[<= k]. One with inverse dynamics looks `preview` ticks ahead; the
caller shifts its output by as many rows. Without preview it is the same filter, and its output is late by
`residual_delay_ticks`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.plugins import Registry
from hyst_control.chain import Chain, Parallel, Sampling, Stage
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.chain.chain import at_rest, resolved
from hyst_control.chain.hysteresis.inverse_multiplicative import InverseMultiplicative, slope_range
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayFilter, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, LinearStage
from hyst_control.chain.memoryless import Gain, Offset, Saturation
from hyst_control.chain.stage import per_axis_scalar
from hyst_control.control.feedforward.inverse_dynamics import invert_dynamics, zero_phase_low_pass
from hyst_control.control.feedforward.mhl_inverse import (
    composite,
    constant_removed,
    inverse_rate_correction,
    inverted,
    rate_dependent_parts,
    whole_inverse,
)
from hyst_control.model_file import Model

FROM_MODEL = (-1.0,)
"""In place of N(s)'s denominator: `model_rate_filter`."""
FILTER_DAMPING = 0.8
"""Of N(s), as published (MHL paper §4.4)."""
BELOW_MODE = 3.0
"""First resonance over the corner of N(s): little phase where the rate correction was identified, little gain at the resonance."""


class Compensator:
    """A running compensator: reference (N, A) in the measurement unit to command (N, A) in V, streaming.

    With `preview` q > 0 the output row i belongs to the tick of input row i - q. `residual_delay_ticks` says by how many
    ticks the command is late where preview was declined. `limits` (2, A) is the drive that it never leaves. `left_out` names the
    parts of the model that it does not invert.
    """

    left_out: tuple[str, ...] = ()

    def __init__(
        self, stages: Sequence[Stage], model: Model, sample_time: float, preview: int, residual_delay_ticks: int, limits: Array
    ) -> None:
        self.stages = tuple(stages)
        self.axes = model.axes
        self.sample_time = sample_time
        self.preview = preview
        self.residual_delay_ticks = residual_delay_ticks
        self.limits = limits
        self._filter = Chain(self.stages).filter(Sampling(sample_time, len(model.axes), "foh"))

    def settle(self, reference: Array) -> Array:
        """Come to rest at the reference (A,), reached from 0 V on the initial loading curve; returns the command (A,) in V."""
        return self._filter.settle(np.asarray(reference, dtype=float))

    def process(self, block: Array) -> Array:
        """Command rows (N, A) in V for a `block` of reference rows (N, A) in the measurement unit."""
        return self._filter.process(np.ascontiguousarray(block, dtype=float))

    def c_code(self) -> CCode:
        """The compensator in C, see `chain.c_code`. Raises `InputError` where a stage has none."""
        return self._filter.c_code()


@dataclass(frozen=True)
class Design:
    """Options of `build_compensator`, checked, as a kind's function gets them beside the model.

    kind: under which it was called; sample_time: s; limits (2, A): V, lower and upper. The others as `build_compensator` has them.
    """

    kind: str
    sample_time: float
    limits: Array
    inverse: str = "zpetc"
    discretisation: str = "zoh"
    preview: bool = True
    iterations: int | None = None
    inverse_model: Model | None = None
    rate_filter: Sequence[float] | None = FROM_MODEL
    smoothing: int = 0

    @property
    def rating(self) -> Saturation:
        """The stage that ends every compensator: it never leaves the drive's limits."""
        return Saturation(self.limits[0].tolist(), self.limits[1].tolist())


Builder = Callable[[Model, Design], Compensator]
"""Builds one kind of compensator; a plugin's, under `hyst_control.controllers`, is one too."""


def build_compensator(
    model: Model,
    kind: str,
    *,
    sample_time: float | None = None,
    inverse: str = "zpetc",
    discretisation: str = "zoh",
    limits: tuple[ArrayLike, ArrayLike] | None = None,
    preview: bool = True,
    iterations: int | None = None,
    inverse_model: Model | None = None,
    rate_filter: Sequence[float] | None = FROM_MODEL,
    smoothing: int = 0,
) -> Compensator:
    """Build the compensator of a model.

    Parameters
    ----------
    model
        Model of the plant.
    kind
        One of `KINDS`, as docs/control.md describes them.
    sample_time
        Sample time, s; the model's by default.
    inverse
        Inverse of the dynamics: "zpetc", "zmetc", "npz_ignore" or "none" (static gain only); used by the kinds that invert them.
    discretisation
        "zoh" (exact, delays included) or "tustin" (as published), of the dynamics, or of N(s) Ψ'.
    limits
        Lower and upper limit of the drive, V, one value or (A,); the model's valid command range by default.
    preview
        True to look ahead, False for the causal form.
    iterations
        Steps per sample of the inverse multiplicative structure (default 4; 1 is HAMPI paper Eq. 13, 0 solves exactly), or passes
        over the rate correction of `mhl_inverse` (default 6).
    inverse_model
        Model from the measurement to V with separately identified inverse curves, for `mhl` and `mhl_static`.
    rate_filter
        Denominator of N(s), descending powers of s, for `mhl`; None for no filter; by default a third of the model's first resonance
        (`model_rate_filter`).
    smoothing
        Order of the low-pass without phase (`inverse_dynamics.zero_phase_low_pass`) that the reference passes first, 0 for none;
        for the kinds that look ahead, which then look as many ticks further ahead. For `mhl` that of an N without phase in place of
        `rate_filter` (`mhl_inverse.composite`), which looks `smoothing` + 1 ticks ahead.

    Returns
    -------
    Compensator
        Compensator, from reference rows to command rows.

    Raises
    ------
    InputError
        The kind is not known or does not fit the model, or the model cannot be inverted within the limits.
    """
    if kind not in KINDS:
        raise InputError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
    if smoothing < 0:
        raise InputError(f"smoothing: must be >= 0, got {smoothing}")
    bounds = drive_limits(model, limits)
    time, how = float(sample_time or model.sample_time), (inverse, discretisation, preview, iterations)
    design = Design(kind, time, bounds, *how, inverse_model, rate_filter, smoothing)
    compensator = KINDS[kind](model, design)
    compensator.left_out = _left_out(model, design, KINDS[kind])
    return compensator


def _left_out(model: Model, design: Design, builder: Builder) -> tuple[str, ...]:
    """Parts of a model that a kind of compensator replaces by their gain at rest."""
    static = builder in (_proportional, _mhl) or (builder is _inverse_chain and design.inverse == "none")
    if not static or design.inverse_model is not None:
        return ()
    stages, axes = model.chain.stages, len(model.axes)
    linear = [stage for stage in stages if isinstance(stage, LinearStage)]
    found = {
        "the hysteresis": builder is _proportional and any(stage.has_compensator for stage in stages),
        "the rate dependence": design.kind == "mhl_static" and any(isinstance(stage, Parallel) for stage in stages),
        "the dynamics": any(len(system.A) for stage in linear for system in stage.systems(axes)),
        "the delay": any(np.any(per_axis_scalar(stage.tau, axes, "tau")) for stage in stages if isinstance(stage, Delay)),
        "the cross-coupling": axes > 1 and any(stage.mixes_axes for stage in linear),
    }
    return tuple(name for name, absent in found.items() if absent)


def _proportional(model: Model, design: Design) -> Compensator:
    """The model's mean static gain alone."""
    slope, offset = mean_line(model, *design.limits)
    return _without_preview([Offset((-offset).tolist()), Gain((1.0 / slope).tolist())], model, design)


def _mhl(model: Model, design: Design) -> Compensator:
    """The MHL paper's compensators: Eq. 6, 7 and §4.4, or Eq. 9 alone."""
    if not design.smoothing or design.kind != "mhl":
        rate_filter = model_rate_filter(model) if tuple(design.rate_filter or ()) == FROM_MODEL else design.rate_filter
        return _without_preview(_mhl_stages(model, design, rate_filter), model, design)
    if design.inverse_model is None:
        raise InputError(f"smoothing: {design.smoothing} for kind mhl needs an inverse_model that was identified behind it")
    ahead = design.smoothing + 1
    late = 0 if design.preview else ahead
    stages = [*_mhl_stages(model, design, None), design.rating]
    return Compensator(stages, model, design.sample_time, ahead - late, late, design.limits)


def _mhl_stages(model: Model, design: Design, rate_filter: Sequence[float] | None) -> list[Stage]:
    """Composite feedforward of the MHL paper, from a separately identified inverse or from the model's own curves."""
    axes, corrected = len(model.axes), design.kind == "mhl"
    tustin = Sampling(design.sample_time, axes, "foh") if design.discretisation == "tustin" else None
    if design.inverse_model is not None:
        front, core, _ = split(design.inverse_model)
        hysteresis, correction = rate_dependent_parts(core)
        return front + composite(hysteresis, correction if corrected else None, rate_filter, tustin, design.smoothing)
    before, core, after = split(model)
    if not isinstance(core, (Madelung, Parallel)):
        raise InputError(
            f"kind: {design.kind!r} needs a madelung stage, which the model {model.name} has not: take none, hapi or hampi"
        )
    direct, forward = rate_dependent_parts(core)
    stages, _ = dynamics_inverse(after, Sampling(model.sample_time, axes), "none", "zoh")
    stages += constant_removed(forward, axes)
    lead = inverse_rate_correction(direct, forward, axes) if forward is not None and corrected else None
    front, _ = dynamics_inverse(before, Sampling(model.sample_time, axes), "none", "zoh")
    return [*stages, *composite(inverted(direct), lead, rate_filter, tustin), *front]


def model_rate_filter(model: Model) -> tuple[float, ...] | None:
    """Denominator of N(s), descending powers of s: a low-pass of second order below the first resonance; None without one."""
    from hyst_control.control.moving_modes import first_mode  # here, not above: it imports more of scipy than a node needs

    before, _, after = split(model)
    mode = first_mode([*before, *after], len(model.axes))
    if mode is None:
        return None
    corner = abs(mode) / BELOW_MODE
    return corner**-2, 2.0 * FILTER_DAMPING / corner, 1.0


def _without_preview(stages: Sequence[Stage], model: Model, design: Design) -> Compensator:
    """A compensator that does not look ahead."""
    if design.smoothing:
        raise InputError(f"smoothing: {design.smoothing} for kind {design.kind}, which does not look ahead: leave it out")
    return Compensator([*stages, design.rating], model, design.sample_time, 0, 0, design.limits)


def _inverse_chain(model: Model, design: Design) -> Compensator:
    """Inverse dynamics, then the inverse of the hysteresis (HAMPI paper §4, and past the MHL paper)."""
    before, _, after = split(model)
    # A DAC holds the command; behind dynamics the signal is smooth.
    held = Sampling(design.sample_time, len(model.axes), "zoh")
    entering = held.with_hold("foh" if any(isinstance(stage, LinearStage) for stage in before) else "zoh")
    # What looks ahead anyway for a reference without kinks restores the gain at the zeros that cannot be inverted.
    behind, ahead = dynamics_inverse(after, entering, design.inverse, design.discretisation, restored=design.smoothing > 0)
    front, further = dynamics_inverse(before, held, design.inverse, design.discretisation)
    hysteresis = core_inverse(model, design.limits, design.kind, entering, design.iterations)
    stages = [*behind, *hysteresis, *front, design.rating]
    ahead += further
    if design.inverse != "none" and not any(isinstance(stage, (LinearStage, Delay)) for stage in (*before, *after)):
        ahead = 1  # Without dynamics the sample still comes one tick after its command.
    if design.smoothing:
        stages.insert(0, zero_phase_low_pass(design.smoothing, held.axes, design.sample_time))
        ahead += design.smoothing
    late = 0 if design.preview else ahead
    return Compensator(stages, model, design.sample_time, ahead - late, late, design.limits)


KINDS: Registry[Builder] = Registry(
    "controllers",
    "a function of a model and a Design",
    lambda name, value: callable(value),
    {
        "none": _proportional,
        "hapi": _inverse_chain,
        "hampi": _inverse_chain,
        "mhl": _mhl,
        "mhl_static": _mhl,
        "mhl_inverse": _inverse_chain,
    },
)
"""Every kind of compensator by name."""


def drive_limits(model: Model, limits: tuple[ArrayLike, ArrayLike] | None) -> Array:
    """Lower and upper limits (2, A) of the drive, V: those given, or the model's valid command range."""
    given = limits if limits is not None else model.valid.get("command")
    if given is None:
        raise InputError("limits: the model says no valid command range: give the drive's rating, lower and upper in V")
    if limits is None:
        given = np.array(given, dtype=float).T
    bounds = np.stack([np.broadcast_to(np.asarray(side, dtype=float), (len(model.axes),)) for side in given])
    if not np.all(np.isfinite(bounds)) or np.any(bounds[0] >= bounds[1]):
        raise InputError(f"limits: lower must be below upper, got {bounds[0].tolist()} to {bounds[1].tolist()} V")
    return np.array(bounds)


def quasi_static(model: Model, commands: Array) -> Array:
    """Output (N, A) of a model at rest at commands (N, A)."""
    return at_rest(resolved(model.chain.stages, len(model.axes)), np.array(commands, dtype=float))


def mean_line(model: Model, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Slope (A,) and intercept (A,) of the line through the slow loop between two commands (A,); raises `InputError` where it is flat."""
    valid = model.valid.get("command")
    if valid is not None:
        inside = np.array(valid, dtype=float).reshape(-1, 2)
        lower, upper = np.maximum(lower, inside[:, 0]), np.minimum(upper, inside[:, 1])
    ramp = np.linspace(lower, upper, 201)
    loop = np.concatenate([ramp, ramp[::-1], ramp, ramp[::-1]])
    output = quasi_static(model, loop)[-2 * len(ramp) :]
    lines = [np.polyfit(loop[-2 * len(ramp) :, axis], output[:, axis], 1) for axis in range(output.shape[1])]
    slope, offset = np.array(lines).T
    if np.any(slope == 0.0) or not np.all(np.isfinite(slope)):
        raise InputError("chain: the output does not depend on the command at rest: this model has no static gain to invert")
    return slope, offset


def split(model: Model) -> tuple[list[Stage], Stage | None, list[Stage]]:
    """Split a model's chain at its hysteresis: stages before it, itself or None, stages after it; delays go to a linear side.

    Quantization and limits, which have no inverse that a feedforward could use, are left out.
    """
    delays = [stage for stage in model.chain.stages if isinstance(stage, Delay)]
    sides: tuple[list[Stage], list[Stage]] = ([], [])
    core: Stage | None = None
    for index, stage in enumerate(model.chain.stages):
        if stage.has_compensator:
            if core is not None:
                raise InputError(
                    f"chain[{index}] ({stage.name}): a second hysteresis: a compensator inverts one; "
                    "use the lifted inverse of the whole chain"
                )
            core = stage
        elif isinstance(stage, (LinearStage, Gain, Offset)):
            sides[core is not None].append(stage)
        elif not (isinstance(stage, Delay) or stage.only_limits):
            raise InputError(f"chain[{index}] ({stage.name}): has no inverse here: use the lifted inverse of the whole chain")
    # A delay commutes with the hysteresis, so it joins the dynamics that follow it.
    target = sides[1] if any(isinstance(stage, LinearStage) for stage in sides[1]) or not sides[0] else sides[0]
    target.extend(delays)
    return sides[0], core, sides[1]


def dynamics_inverse(
    side: list[Stage], sampling: Sampling, method: str, discretisation: str, restored: bool = False
) -> tuple[list[Stage], int]:
    """Inverse of linear stages, gains and offsets, and the ticks that it looks ahead."""
    axes = sampling.axes
    linear = [stage for stage in side if isinstance(stage, (LinearStage, Delay))]
    # Offsets are carried to the output of the side; gains and the static gain of the dynamics commute with the dynamics.
    bias = at_rest(side, np.zeros((1, axes)))[0]
    gain = np.prod(
        [per_axis_scalar(stage.gain, axes, "gain") for stage in side if isinstance(stage, Gain)] or [np.ones(axes)], axis=0
    )
    stages: list[Stage] = [Offset((-bias).tolist())] if np.any(bias != 0.0) else []
    if np.any(gain == 0.0):
        raise InputError("gain: is 0: the command does not reach the output")
    if np.any(gain != 1.0):
        stages.append(Gain((1.0 / gain).tolist()))
    if not linear:
        return stages, 0
    if method == "none":
        whole = at_rest(linear, np.stack([np.zeros(axes), np.ones(axes)]))
        return [*stages, Gain((1.0 / (whole[1] - whole[0])).tolist())], 0
    inverted = invert_dynamics(linear, sampling, method, discretisation, restored=restored)
    return [*stages, *inverted.stages], inverted.preview


def core_inverse(model: Model, limits: Array, kind: str, sampling: Sampling, iterations: int | None) -> list[Stage]:
    """Inverse of the hysteresis of a model for a drive within limits (2, A), V; no stages where there is none."""
    before, core, after = split(model)
    if kind == "mhl_inverse":
        hysteresis, correction = rate_dependent_parts(core)
        return whole_inverse(hysteresis, correction, after, sampling, 6 if iterations is None else iterations)
    if core is None:
        return []
    if isinstance(core, Madelung):
        return [inverted(core)]
    if isinstance(core, RateDependentPrandtlIshlinskii) and kind == "hapi":
        core = PrandtlIshlinskii(core.thresholds, core.weights, w0=core.w0)
    if not isinstance(core, (PrandtlIshlinskii, ModifiedPrandtlIshlinskii)):
        raise InputError(f"kind: {kind!r} inverts prandtl_ishlinskii and modified_prandtl_ishlinskii, not {core.name}")
    own = {item.name: getattr(core, item.name) for item in fields(core)}
    if kind == "hapi":
        own = {name: value for name, value in own.items() if name not in ("m1", "m2", "k", "b", "levels", "center")}
    # The hysteresis sees the drive through the static gain of what stands before it.
    valid = limits if model.valid.get("command") is None else drive_limits(model, None)
    drive, needed = (np.sort(at_rest(before, each), axis=0) for each in (limits, valid))
    lower, upper = invertible_range(core.__class__(**own), drive, needed[1])
    return [
        InverseMultiplicative(**own, lower=lower.tolist(), upper=upper.tolist(), iterations=4 if iterations is None else iterations)
    ]


def invertible_range(core: PrandtlIshlinskii | ModifiedPrandtlIshlinskii, drive: Array, needed: Array) -> Array:
    """Limits (2, A) of the drive, V, over which the output rises with the command, 0 < dY/du: at least up to `needed`."""
    axes = drive.shape[1]
    coefficients = np.array([per_axis_scalar(getattr(core, name, 0.0), axes, name) for name in ("w0", "k", "b", "center")])
    operators = PlayFilter(Sampling(1.0, axes), core.thresholds, core.weights, core.one_sided, getattr(core, "levels", None))
    upper = drive[1].copy()

    def min_slope(axis: int, end: float) -> tuple[float, float, float, float]:
        plays = operators.thresholds[axis], operators.release[axis], operators.weights[axis], operators.levels[axis]
        w0, k, b, center = coefficients[:, axis]
        return slope_range(plays, (w0, k, b, center), drive[0, axis], end)

    for axis in range(axes):
        if min_slope(axis, upper[axis])[0] > 0.0:
            continue
        low, high = min(needed[axis], upper[axis]), upper[axis]
        least, _, _, where = min_slope(axis, low)
        if least <= 0.0:
            raise InputError(
                f"weights of axis {axis}: the model's output falls while the command rises near {where:.4g} V "
                f"(dY/du {least:.3g}): no inverse; narrow the limits or fit it with positive weights"
            )
        while high - low > 1e-3 * (drive[1, axis] - drive[0, axis]):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if min_slope(axis, middle)[0] > 0.0 else (low, middle)
        upper[axis] = low
    return np.stack([drive[0], upper])
