"""Feedforward compensators built from a model: chains of stages from the reference to the command.

| kind          | command                                                                                                  |
|---------------|----------------------------------------------------------------------------------------------------------|
| `none`        | reference through the model's mean static gain, no dynamics, no hysteresis                                |
| `hapi`        | inverse dynamics, then the inverse of the classical part of the Prandtl-Ishlinskii model                  |
| `hampi`       | inverse dynamics, then the inverse multiplicative structure with dynamic weights (HAMPI paper §4)         |
| `mhl`         | H_S^-1 and the rate correction behind its filter N(s), in parallel (MHL paper Eq. 6, 7 and §4.4)           |
| `mhl_static`  | H_S^-1 alone, the traditional compensator (MHL paper Eq. 9)                                               |
| `mhl_inverse` | inverse dynamics, then the inverse of the whole rate-dependent part: past the paper                       |

A compensator runs with hold `foh`: command[k] from reference[<= k]. One with inverse dynamics looks `preview` ticks ahead; the
caller shifts its output by as many rows. Without preview it is the same filter, and its output is late by
`residual_delay_ticks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.chain import Chain, Parallel, Sampling, Stage
from hyst_control.chain.inverse_multiplicative import InverseMultiplicative, slope_range
from hyst_control.chain.linear import Delay, LinearStage, RateCorrection, TransferFunction
from hyst_control.chain.madelung import Madelung
from hyst_control.chain.play import ModifiedPrandtlIshlinskii, PrandtlIshlinskii, play_filter
from hyst_control.chain.stage import Array, per_axis_scalar
from hyst_control.chain.static import Gain, Offset, Quantization, Saturation
from hyst_control.control.inverse_dynamics import invert_dynamics
from hyst_control.control.quasi_static import hysteretic, mean_line, quasi_static_stages
from hyst_control.errors import InputError
from hyst_control.model_file import Model

KINDS = ("none", "hapi", "hampi", "mhl", "mhl_static", "mhl_inverse")
RATE_FILTER = (3.23e-7, 9.1e-4, 1.0)
"""Denominator of N(s) = 1 / (3.23e-7 s² + 9.1e-4 s + 1), descending powers of s (MHL paper §4.4)."""


class Compensator:
    """A running compensator: reference (N, A) in the measurement unit to command (N, A) in V, streaming.

    With `preview` q > 0 the output row i belongs to the tick of input row i - q. `residual_delay_ticks` says by how many
    ticks the command is late where preview was declined. `limits` (2, A) is the drive that it never leaves.
    """

    def __init__(self, stages: Sequence[Stage], model: Model, sample_time: float, preview: int, residual_delay_ticks: int,
                 limits: Array) -> None:
        self.stages = tuple(stages)
        self.axes = model.axes
        self.sample_time = sample_time
        self.preview = preview
        self.residual_delay_ticks = residual_delay_ticks
        self.limits = limits
        self._filter = Chain(self.stages).filter(Sampling(sample_time, len(model.axes), "foh"))

    def settle(self, reference: Array) -> Array:
        """Come to rest at the reference (A,), reached from 0 V on the virgin curve; returns the command (A,) in V."""
        return self._filter.settle(np.asarray(reference, dtype=float))

    def process(self, block: Array) -> Array:
        """Reference rows (N, A) to command rows (N, A) in V."""
        return self._filter.process(np.ascontiguousarray(block, dtype=float))


def build_compensator(model: Model, kind: str, *, sample_time: float | None = None, inverse: str = "zpetc",
                      discretisation: str = "zoh", limits: tuple[ArrayLike, ArrayLike] | None = None, preview: bool = True,
                      iterations: int | None = None, inverse_model: Model | None = None,
                      rate_filter: Sequence[float] | None = RATE_FILTER) -> Compensator:
    """A compensator of one of `KINDS` for a model; see the module.

    sample_time s (the model's by default); inverse: "zpetc", "zmetc", "npz_ignore" or "none" (static gain only), of the
    dynamics, for the kinds that invert them; discretisation: "zoh" (exact, delays included) or "tustin" (as published);
    limits: (lower, upper) V, the drive's rating (the model's valid command range by default); preview: False for the causal
    form; iterations: steps per sample of the inverse multiplicative structure (default 4; 1 is HAMPI paper Eq. 13, 0
    solves exactly), or passes over the rate correction of `mhl_inverse` (default 4); inverse_model: a model file from the
    measurement to V with inverse curves identified by themselves (`mhl`, `mhl_static`); rate_filter: denominator of N(s), None
    for none.

    Raises `InputError` when the kind does not fit the model, or the model cannot be inverted within the limits.
    """
    if kind not in KINDS:
        raise InputError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
    sample_time = float(sample_time or model.sample_time)
    bounds = drive_limits(model, limits)
    rating = Saturation(bounds[0].tolist(), bounds[1].tolist())
    if kind == "none":
        slope, offset = mean_line(model, *bounds)
        stages: list[Stage] = [Offset((-offset).tolist()), Gain((1.0 / slope).tolist())]
        return Compensator([*stages, rating], model, sample_time, 0, 0, bounds)
    if kind in ("mhl", "mhl_static"):
        return Compensator([*mhl_stages(model, kind, inverse_model, rate_filter), rating], model, sample_time, 0, 0, bounds)

    before, core, after = split(model)
    sampling = Sampling(sample_time, len(model.axes), "zoh")
    ahead = 0
    stages = []
    behind, late = dynamics_inverse(after, sampling, inverse, discretisation)
    ahead += late
    stages += behind
    stages += core_inverse(core, kind, model, bounds, iterations)
    front, late = dynamics_inverse(before, sampling, inverse, discretisation)
    ahead += late
    stages += front
    return Compensator([*stages, rating], model, sample_time, ahead if preview else 0, 0 if preview else ahead, bounds)


def drive_limits(model: Model, limits: tuple[ArrayLike, ArrayLike] | None) -> Array:
    """(lower, upper) V as an array (2, A). Raises `InputError` when neither given nor in the model, or the wrong way round."""
    given = limits if limits is not None else model.valid.get("command")
    if given is None:
        raise InputError("limits: the model says no valid command range: give the drive's rating, lower and upper in V")
    if limits is None:
        given = np.array(given, dtype=float).T
    bounds = np.stack([np.broadcast_to(np.asarray(side, dtype=float), (len(model.axes),)) for side in given])
    if not np.all(np.isfinite(bounds)) or np.any(bounds[0] >= bounds[1]):
        raise InputError(f"limits: {bounds[0].tolist()} to {bounds[1].tolist()} V, lower below upper is due")
    return np.array(bounds)


def split(model: Model) -> tuple[list[Stage], Stage | None, list[Stage]]:
    """The chain as (linear stages before the hysteresis, the hysteresis, linear stages after it); delays go to the linear side.

    Stages without an inverse that matters to a feedforward (quantisation, limits) are left out.
    """
    delays = [stage for stage in model.chain.stages if isinstance(stage, Delay)]
    sides: tuple[list[Stage], list[Stage]] = ([], [])
    core: Stage | None = None
    for index, stage in enumerate(model.chain.stages):
        if hysteretic(stage):
            if core is not None:
                raise InputError(f"chain[{index}] ({stage.name}): a second hysteresis: a compensator inverts one; "
                                 "use the lifted inverse of the whole chain")
            core = stage
        elif isinstance(stage, (LinearStage, Gain, Offset)):
            sides[core is not None].append(stage)
        elif not isinstance(stage, (Delay, Saturation, Quantization)) and stage.name != "slew_limit":
            raise InputError(f"chain[{index}] ({stage.name}): has no inverse here: use the lifted inverse of the whole chain")
    # A delay commutes with the hysteresis, so it joins the dynamics that follow it.
    target = sides[1] if any(isinstance(stage, LinearStage) for stage in sides[1]) or not sides[0] else sides[0]
    target.extend(delays)
    return sides[0], core, sides[1]


def dynamics_inverse(side: list[Stage], sampling: Sampling, method: str, discretisation: str) -> tuple[list[Stage], int]:
    """Stages that undo linear stages, gains and offsets, from the last to the first, and the ticks they look ahead."""
    axes = sampling.axes
    linear = [stage for stage in side if isinstance(stage, (LinearStage, Delay))]
    static = [stage for stage in side if isinstance(stage, (Gain, Offset))]
    if not side:
        return [], 0
    # Offsets are carried to the output of the side; gains and the static gain of the dynamics commute with the dynamics.
    bias = quasi_static_stages(side, np.zeros((1, axes)), axes)[0]
    gain = np.prod([per_axis_scalar(stage.gain, axes, "gain") for stage in static if isinstance(stage, Gain)] or [np.ones(axes)],
                   axis=0)
    stages: list[Stage] = [Offset((-bias).tolist())] if np.any(bias != 0.0) else []
    if np.any(gain == 0.0):
        raise InputError("gain: is 0: the command does not reach the output")
    if np.any(gain != 1.0):
        stages.append(Gain((1.0 / gain).tolist()))
    if not linear:
        return stages, 0
    if method == "none":
        whole = quasi_static_stages(linear, np.stack([np.zeros(axes), np.ones(axes)]), axes)
        return [*stages, Gain((1.0 / (whole[1] - whole[0])).tolist())], 0
    inverted = invert_dynamics(linear, sampling, method, discretisation)
    return [*stages, inverted.stage], inverted.preview


def core_inverse(core: Stage | None, kind: str, model: Model, bounds: Array, iterations: int | None) -> list[Stage]:
    """Stages that undo the hysteresis."""
    if core is None:
        return []
    if kind == "mhl_inverse":
        hysteresis, correction = rate_dependent_parts(core)
        return mhl_inverse_stages(hysteresis, correction, model, 4 if iterations is None else iterations)
    if isinstance(core, Madelung):
        return [inverted_madelung(core)]
    if not isinstance(core, (PrandtlIshlinskii, ModifiedPrandtlIshlinskii)):
        raise InputError(f"kind: {kind!r} inverts prandtl_ishlinskii and modified_prandtl_ishlinskii, not {core.name}")
    own = {item.name: getattr(core, item.name) for item in fields(core)}
    if kind == "hapi":
        own = {name: value for name, value in own.items() if name not in ("m1", "m2", "k", "b")}
    lower, upper = invertible_range(core.__class__(**own), model, bounds)
    return [InverseMultiplicative(**own, lower=lower.tolist(), upper=upper.tolist(),
                                  iterations=4 if iterations is None else iterations)]


def invertible_range(core: Stage, model: Model, bounds: Array) -> Array:
    """The part of the drive (2, A) in V over which the output rises with the command: 0 < dY/du.

    Raises `InputError` when that does not cover the model's valid range within the drive.
    """
    axes = len(model.axes)
    values = {name: per_axis_scalar(getattr(core, name, 0.0), axes, name) for name in ("w0", "k", "b")}
    running = play_filter(core, Sampling(1.0, axes))
    valid = drive_limits(model, None) if model.valid.get("command") is not None else bounds
    needed = np.minimum(valid[1], bounds[1])
    upper = bounds[1].copy()
    for axis in range(axes):
        operators = running.thresholds[axis], running.release[axis], running.weights[axis]
        coefficients = [values[name][axis] for name in ("w0", "k", "b")]

        def rises(end: float, operators=operators, coefficients=coefficients, axis=axis) -> bool:
            return slope_range(*operators, *coefficients, bounds[0, axis], end)[0] > 0.0

        if rises(upper[axis]):
            continue
        if not rises(needed[axis]):
            least, _, _, where = slope_range(*operators, *coefficients, bounds[0, axis], needed[axis])
            raise InputError(f"weights of axis {model.axes[axis]}: the model's output falls while the command rises near "
                             f"{where:.4g} V (dY/du {least:.3g}): no inverse; narrow the limits or fit it with positive weights")
        low, high = needed[axis], upper[axis]
        while high - low > 1e-3 * (bounds[1, axis] - bounds[0, axis]):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if rises(middle) else (low, middle)
        upper[axis] = low
    return np.stack([bounds[0], upper])


def rate_dependent_parts(core: Stage) -> tuple[Madelung, RateCorrection | None]:
    """H_S and Ψ of an MHL model's rate-dependent part. Raises `InputError` when it is something else."""
    if isinstance(core, Madelung):
        return core, None
    flat = [stage for branch in core.branches for stage in branch] if isinstance(core, Parallel) else []
    hysteresis = [stage for stage in flat if isinstance(stage, Madelung)]
    correction = [stage for stage in flat if isinstance(stage, RateCorrection)]
    if len(hysteresis) != 1 or len(correction) > 1 or len(flat) != len(hysteresis) + len(correction):
        raise InputError("kind: an MHL compensator needs a madelung stage, alone or in parallel with rate_correction, not "
                         f"{core.name}")
    return hysteresis[0], correction[0] if correction else None


def inverted_madelung(stage: Madelung) -> Madelung:
    """The same curves run from output to input, or back."""
    own = {item.name: getattr(stage, item.name) for item in fields(stage)}
    return Madelung(**{**own, "inverse": not stage.inverse})


def mhl_stages(model: Model, kind: str, inverse_model: Model | None, rate_filter: Sequence[float] | None) -> list[Stage]:
    """u_ff = H_S^-1[y] + N(s) Ψ'[y], from an identified inverse or from the model (MHL paper Eq. 6-9, §4.4)."""
    if inverse_model is not None:
        core = split(inverse_model)[1]
        if core is None:
            raise InputError(f"inverse_model: {inverse_model.name} has no madelung stage")
        hysteresis, correction = rate_dependent_parts(core)
        before: list[Stage] = []
    else:
        _, core, after = split(model)
        if core is None:
            raise InputError(f"kind: {kind!r} needs a madelung stage in the model, {model.name} has none: take kind none")
        direct, forward = rate_dependent_parts(core)
        hysteresis, correction = inverted_madelung(direct), forward and inverse_rate_correction(direct, forward, len(model.axes))
        before, _ = dynamics_inverse(after, Sampling(model.sample_time, len(model.axes)), "none", "zoh")
        if forward is not None:
            offset = per_axis_scalar(forward.b1, len(model.axes), "b1") / per_axis_scalar(forward.b2, len(model.axes), "b2")
            before = [*before, Offset((-offset).tolist())] if np.any(offset) else before
    if kind == "mhl_static" or correction is None:
        return [*before, hysteresis]
    lead: list[Stage] = [correction]
    if rate_filter is not None:
        lead.append(TransferFunction([float(rate_filter[-1])], [float(value) for value in rate_filter]))
    return [*before, Parallel(((hysteresis,), tuple(lead)))]


def mean_slope(stage: Madelung, axes: int) -> Array:
    """Output at full input over the input (A,), measurement unit per V."""
    full = np.array([float(up(np.ones(1))[0]) for up, _ in stage.curves(axes)])
    return (full * per_axis_scalar(stage.output_scale, axes, "output_scale")
            / per_axis_scalar(stage.input_scale, axes, "input_scale"))


def inverse_rate_correction(stage: Madelung, correction: RateCorrection, axes: int) -> RateCorrection:
    """Ψ' such that (1/a + Ψ')(a + Ψ) = 1 with a the mean slope of H_S: again a first-order lag driven by the rate.

    1 / (a + k1 s / (k2 s + b2)) - 1 / a = (-k1 / a²) s / ((k2 + k1 / a) s + b2).
    """
    a = mean_slope(stage, axes)
    k1, k2, b2 = (per_axis_scalar(getattr(correction, name), axes, name) for name in ("k1", "k2", "b2"))
    if np.any(k2 + k1 / a <= 0.0):
        raise InputError("k1: at high frequency the rate correction outweighs the hysteresis itself: its inverse is unstable")
    return RateCorrection((-k1 / a**2).tolist(), (k2 + k1 / a).tolist(), 0.0, b2.tolist())


def mhl_inverse_stages(stage: Madelung, correction: RateCorrection | None, model: Model, passes: int) -> list[Stage]:
    """v with H_S[v] + Ψ[v] = w, by v_0 = H_S^-1[w] + Ψ'[w], v_j+1 = H_S^-1[w - Ψ[v_j]]: a chain of chains, no algebraic loop.

    The error shrinks per pass by |Ψ| / a, which is 0.25 at 100 Hz and at most 0.57 with the published parameters.
    """
    inverse = inverted_madelung(stage)
    if correction is None:
        return [inverse]
    axes = len(model.axes)
    solution: list[Stage] = [Parallel(((inverse,), (inverse_rate_correction(stage, correction, axes),)))]
    for _ in range(passes):
        solution = [Parallel(((Gain(1.0),), (*solution, correction, Gain(-1.0)))), inverse]
    return solution
