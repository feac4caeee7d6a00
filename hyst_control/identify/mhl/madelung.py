# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of Madelung hysteresis from slow loops: the curves f0, g0 of any record, nested loops included.

The curves are polynomials (MHL paper Eq. 1, 2) or monotone piecewise cubics. Closure is built into the parameters, and
monotony into the search as linear inequalities, so that every fit is a model that loads and has an inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Stage
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.chain.stage import per_axis_scalars
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.data.fit_windows import response_sign, virgin_rows, whole_records, with_sign
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.families.options import INTEGER, NUMBER, NUMBERS, Options, option
from hyst_control.identify.families.shared_options import nuisance_option
from hyst_control.identify.mhl.madelung_curves import Curves, Ends
from hyst_control.identify.solve.gram_sums import NUISANCES, Window
from hyst_control.identify.solve.simulation_error import Parametrization, Solution, minimize_simulation_error
from hyst_control.records.record import Record

NEAR = 0.05
"""Share of the upper end up to which a lowest command is near 0 V, and of the curves' range that no record need reach."""


@dataclass(frozen=True)
class CurveOptions(Options):
    """Options of the curves' form."""

    degree: int = option(
        5, INTEGER, "degree of the curves' polynomials, where `knots` does not make them piecewise", lower=1, upper=12
    )
    knots: tuple[float, ...] | None = option(
        None,
        NUMBERS,
        "knots of piecewise cubics in place of polynomials, increasing from 0 to 1 of the range of the curves",
        lower=0.0,
        upper=1.0,
    )
    input_scale: float | None = option(
        None, NUMBER, "command at the upper end of the curves, in place of the largest one of the records", unit="V", lower=0.0
    )
    input_offset: float | None = option(
        None, NUMBER, "command at the lower end of the curves, in place of the lowest one of the records", unit="V"
    )

    @property
    def curves(self) -> Curves:
        """The form of the curves."""
        return Curves(self.degree, self.knots)

    def check(self) -> None:
        if self.input_scale is not None and self.input_scale <= (self.input_offset or 0.0):
            raise InputError(
                f"input_scale: must be > {self.input_offset or 0:g} V, the lower end of the curves, got {self.input_scale:g}"
            )
        _ = self.curves


@dataclass(frozen=True)
class MadelungOptions(CurveOptions):
    """Options of a fit of Madelung curves."""

    nuisance: str = nuisance_option("linear")


@register
class MadelungCurves(Estimator[MadelungOptions]):
    """Madelung hysteresis without dynamics."""

    name = "madelung"
    sentence = "Madelung hysteresis without dynamics, and the sensor's zero: rising curves from slow loops, nested ones included"
    Options = MadelungOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: MadelungOptions) -> AxisFit:
        found = fit_records(whole_records(records, index, weighted=False), options)
        rest = [*turned_by(found.sign), *([Offset(found.offset)] if found.offset else [])]
        return AxisFit(
            lambda vector: [found.curves.stage(vector, found.ends, found.output_scale), *rest],
            found.solution.parameters,
            found.solution.covariance,
            found.curves.numbers,
            tolerance=found.curves.tolerance(found.solution.parameters, found.solution.covariance),
            notes=lambda _: range_notes(records, index, found.ends),
        )


def turned_by(sign: float) -> list[Stage]:
    """The last stage where the measurement falls as the command rises; none elsewhere."""
    return [Gain(sign)] if sign < 0 else []


@dataclass(frozen=True)
class CurveFit:
    """Curves of one axis."""

    curves: Curves  # Form of the curves
    solution: Solution  # Their parameters, in units of output_scale
    ends: Ends  # Commands at the ends of the curves
    output_scale: float  # Scale of the output (measurement unit)
    sign: float  # Sign of the response, 1 or -1
    offset: float  # Zero of the measurement (measurement unit)

    @property
    def stage(self) -> Madelung:
        """The axis' hysteresis."""
        return self.curves.stage(self.solution.parameters, self.ends, self.output_scale)


def fit_records(windows: Sequence[Window], options: MadelungOptions) -> CurveFit:
    """Identify the curves of one axis from whole records.

    From 0 V at the lower end the first loading is the ascending branch. From anywhere else it is no branch of the major loop, and the
    rows before the command has met both its extremes do not count.
    """
    ends = curve_ends(windows, options)
    if ends.lower != 0.0:
        windows = [
            window if window.memory is not None else replace(window, skip=max(window.skip, virgin_rows(window.command)))
            for window in windows
        ]
    return fit_curves(windows, options.curves, ends, options.nuisance)


def fit_curves(
    windows: Sequence[Window],
    curves: Curves,
    ends: Ends,
    nuisance: str,
    *,
    inverse: bool = False,
    passes: int = 40,
) -> CurveFit:
    """Identify the curves of one axis."""
    sign = response_sign(windows)
    travel = (
        max(float(np.ptp(window.measurement)) / float(np.ptp(window.command)) for window in windows if np.ptp(window.command))
        * ends.length
    )
    turned = [with_sign(window, sign) for window in windows]

    def stages(vector: Array) -> list[Stage]:
        return [curves.stage(vector, ends, travel)]

    problem = Parametrization(stages, *curves.constraints())
    start = curves.start(-0.15 if inverse else 0.15)
    solution = minimize_simulation_error(turned, problem, start, nuisance=nuisance, passes=passes, tolerance=1e-6, everything=True)
    return CurveFit(curves, solution, ends, travel, sign, sign * mean_offset(solution, windows, nuisance))


def fit_inverse(stage: Madelung, curves: Curves | None = None) -> Madelung:
    """Fit separate curves for the inverse to the major loop of a model of one axis (MHL paper Table 1, right).

    The result runs from output to command; it is not the closed-form inverse but near it, as the paper's is.
    """
    curves = curves or Curves()
    input_scale, output_scale = (float(each[0]) for each in per_axis_scalars(stage, 1, "input_scale", "output_scale"))
    full = output_scale * float(stage.curves(1)[0][0](np.ones(1))[0])
    x = np.linspace(0.0, 1.0, 401)
    up, down = (output_scale * curve(x) for curve in stage.curves(1)[0])
    demand, command = np.concatenate([up, down[::-1]]), input_scale * np.concatenate([x, x[::-1]])
    window = Window(demand, command, 1.0, "foh", 0, 0)
    ends = Ends(0.0, full)
    found = fit_curves([window], curves, ends, "none", inverse=True)
    vector = found.solution.parameters / curves.full(found.solution.parameters)
    return curves.stage(vector, ends, input_scale)


def curve_ends(windows: Sequence[Window], options: CurveOptions) -> Ends:
    """Commands at the ends of the major loop."""
    upper = options.input_scale
    if upper is None:
        upper = max(float(window.command.max()) for window in windows)
    lower = options.input_offset
    if lower is None:
        lower = min(float(window.command.min()) for window in windows)
        lower = 0.0 if -0.01 * upper <= lower <= NEAR * upper else lower
    if upper <= lower:
        raise InputError(f"input_scale: must be > {lower:g} V, the lower end of the curves, got {upper:g}")
    return Ends(lower, upper - lower)


def mean_offset(solution: Solution, windows: Sequence[Window], nuisance: str) -> float:
    """Mean of the records' offsets, weighted by their numbers of rows."""
    extra = NUISANCES[nuisance]
    if not extra:
        return 0.0
    rows = np.zeros(max(window.group for window in windows) + 1)
    for window in windows:
        rows[window.group] += len(window.command) - window.skip
    return float(np.average(solution.nuisances[::extra], weights=np.maximum(rows, 1e-9)))


def range_notes(records: Sequence[Record], index: int, ends: Ends) -> list[str]:
    """Name the part of the curves of one axis that the records do not reach, with the excitation that would show it."""
    low = (min(float(data.command[:, index].min()) for data in records) - ends.lower) / ends.length
    high = (max(float(data.command[:, index].max()) for data in records) - ends.lower) / ends.length
    if low <= NEAR and high >= 1.0 - NEAR:
        return []
    return [
        f"axis {records[0].axes[index]}: the records span {100 * low:.0f} to {100 * high:.0f} % of {ends.lower:g} to {ends.upper:g} V: "
        "the curves beyond are a continuation; record a slow loop over the whole drive"
    ]
