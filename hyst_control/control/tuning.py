# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Automatic tuning of the PI feedback to stability margins, from a model's linear part as the loop samples it (docs/control.md).

The loop is L(z) = P(z) z^-d F(z) (kp + ki T z / (z - 1) + D(z) - G(z)): P exact for the held command, delays included, d further
ticks where the loop carries them (a loop closed over topics on wall-clock timers carries about one), F the roll-off and the notches
of the feedback, D its derivative and G its damping (`feedback.filters`), where they are asked for. Among all gains that keep the
margins for every case of plant gain and resonances, the one with the greatest ki is taken: it has the least integral of the
error after a load step (Astrom and Hagglund, Advanced PID Control, 2006, §4.6 and §6.3). Among shapes (`feedback_shapes`), each with
its gains, the one whose step has the least integral of the absolute error is taken: the greatest ki of all belongs to a low corner
and a great kp, which overshoot.

Where the plant mixes its axes, which all have the same feedback, the loops are the characteristic loci: the eigenvalues of P times
the feedback. The closed loop is stable exactly where Nyquist's criterion holds for these (MacFarlane and Postlethwaite, 1977).

The model discrepancy is a relative one: the plant's response may lie anywhere within `model_error` |P| of the model's, at every
frequency and in every case (multiplicative uncertainty, Doyle, Francis and Tannenbaum, Feedback Control Theory, 1992, §4). The
margins hold for the worst of these plants. Of axes that are mixed it is (I + E) P or P (I + E) with any matrix E of a greatest singular
value up to `model_error`, and the sensitivity's size its greatest singular value: S of such a plant is at most
|S| / (1 - model_error |T|), as for one axis (Skogestad and Postlethwaite, Multivariable Feedback Control, 2005, §8.6). Eigenvalues say
nothing of either where the plant is not normal; gain and phase margin are those of the loci, for changes that all axes share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import Quantity
from hyst_control.chain import Stage
from hyst_control.control.feedback.filters import Filters, response
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedback_shapes import STRUCTURES, Shape, shapes
from hyst_control.control.linear_step import Step, law_sections, linear_step
from hyst_control.control.linearization import has_dynamics, hysteresis_slopes, linearized, modes, sampled_response
from hyst_control.control.loop_margins import Margins, courses_of, crossing_180, phase_margin_of
from hyst_control.control.moving_modes import Resonances, resonances
from hyst_control.control.plant_cases import Plants, spread_responses
from hyst_control.model_file import Model, Simulator
from hyst_control.reporting.tables import Table

LOWEST = 1e-5
"""Lowest frequency of a response, relative to half the sampling rate, in whose loop the integral action prevails; else a lower one."""
UNKNOWN = 0.1
"""Greatest |L| where a model without dynamics is not known: a resonance there may amplify 5 times within a gain margin of 6 dB."""
AROUND = 60
"""Points of a response on either side of a resonance, in equal ratios from a tenth of its half width to a tenth of its frequency."""
MUCH = 2.0
"""Times its bandwidth that a loop would have without a resonance from which on that is said: what a notch or damping may well gain."""
NAMED = 3
"""Resonances that such a sentence names at most."""
LOWEST_SCALE = 1e-15
"""Of the gain at which the gain margin would be kept; a loop that cannot keep its margins at this little of it never does."""


@dataclass(frozen=True)
class Tuning:
    """Gains and what they give.

    kp (V per measurement unit) and ki (V per measurement unit and s), margins of the model as it is and the worst over the spread and
    the model discrepancy, settling_time s of a step into 2 %, overshoot in per cent; roll_off Hz, 0 without; filters: notches,
    derivative and damping; notes: sentences on what the margins rest on.
    """

    kp: float
    ki: float
    sample_time: float
    nominal: Margins
    worst: Margins
    settling_time: float
    overshoot: float
    roll_off: float = 0.0
    filters: Filters = Filters()
    notes: tuple[str, ...] = ()

    def controller(self, lower: float, upper: float, slew_limit: float = 0.0) -> PI:
        """Tuned controller with the command limits `lower` and `upper` in V and `slew_limit` in V/s (0 for none)."""
        return PI(self.kp, self.ki, self.sample_time, lower, upper, slew_limit, roll_off=self.roll_off, filters=self.filters)

    @property
    def law(self) -> PI:
        """Tuned controller without limits."""
        return self.controller(-1e300, 1e300)

    @property
    def parameters(self) -> dict[str, float | list[float]]:
        """Parameters of the node `pi_feedback` that are not at their default."""
        given = {"kp": self.kp, "ki": self.ki, "roll_off": self.roll_off, **vars(self.filters)}
        plain = {"roll_off": 0.0, **vars(Filters())}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in given.items()
            if name not in plain or value != plain[name]
        }

    def sensitivity(self, model: Model, frequency: Sequence[float], loop_delay: int = 0) -> Array:
        """Greatest singular value (F,) of S = 1 / (1 + L) of a nominal model at a frequency, Hz, with a loop_delay of further ticks."""
        z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * self.sample_time)
        found = np.zeros(len(z))
        moving = (z != 1.0) | (self.ki == 0.0)  # integral action has no bound at 0 Hz
        plant = Plants.nominal(model, self.sample_time, loop_delay, z[moving])
        found[moving] = plant.sensitivities(controller_response(self.law, z[moving]))[0].max(axis=0)
        return found

    def step(self, model: Model, length: int) -> Array:
        """Measurement (length, A) of `model` in the linear loop when the reference jumps from 0 to 1."""
        axes = len(model.axes)
        plant = Simulator(model.with_stages(linearized(model)), self.sample_time)
        return run_loop(np.ones((length, axes)), None, self.law.start(axes), plant)["measurement"]

    def table(self, model: Model) -> Table:
        """The result as rows, for the command line and the JSON."""
        table, unit = Table("tune"), model.units["measurement"]
        where = f"{model.name} at {1.0 / self.sample_time:g} Hz"
        symbols = {"kp": f"V/{unit}", "ki": f"V/({unit} s)", "kd": f"V s/{unit}", "damping_gain": f"V/{unit}"}
        symbols |= dict.fromkeys(("roll_off", "derivative_corner", "notch_frequency", "damping_corner"), "Hz")
        of_margins = {"gain_margin": "dB", "phase_margin": "deg", "peak_sensitivity": "", "crossover": "Hz", "bandwidth": "Hz"}
        for name, value in self.parameters.items():
            for number in value if isinstance(value, list) else [value]:
                table.add("PI feedback", where, "controller", name, symbols.get(name, ""), number)
        for subject, case in (("nominal", self.nominal), ("worst case", self.worst)):
            for quantity, symbol in of_margins.items():
                table.add("PI feedback", where, subject, quantity, symbol, getattr(case, quantity))
        table.add("PI feedback", where, "nominal", "settling_time", "s", self.settling_time)
        table.add("PI feedback", where, "nominal", "overshoot", "%", self.overshoot)
        table.notes += self.notes
        return table


AUTOMATIC = "auto"
ASKED = (
    Quantity("gain_margin", 6.0, "dB", "least gain margin", above=0.0),
    Quantity("phase_margin", 45.0, "degrees", "least phase margin", above=0.0, below=90.0),
    Quantity("peak_sensitivity", 2.0, "", "greatest peak of the sensitivity", above=1.0),
    Quantity("loop_delay", 0, "ticks", "further delay of the loop", lower=0, upper=1000),
    *(Quantity(name, 0.0, "", "relative spread", lower=0.0, below=1.0) for name in ("gain_spread", "mode_spread", "model_error")),
    Quantity("roll_off", 0.0, "Hz", "corner of the roll-off", lower=0.0, choices=(AUTOMATIC,)),
    Quantity("structure", "pi", "", "what the feedback is made of", choices=(*STRUCTURES, AUTOMATIC)),
)
"""Arguments of `tune`, with their ranges."""


def tune(
    model: Model,
    *,
    sample_time: float | None = None,
    gain_margin: float = 6.0,
    phase_margin: float = 45.0,
    peak_sensitivity: float = 2.0,
    loop_delay: int = 0,
    gain_spread: float = 0.1,
    mode_spread: float = 0.2,
    model_error: float = 0.15,
    roll_off: float | str = 0.0,
    structure: str = "pi",
) -> Tuning:
    """Gains of the feedback for a model, the same for all axes.

    The hysteresis enters with its greatest slope, so that no part of a loop has less margin.

    Parameters
    ----------
    model
        Model of the plant.
    sample_time
        Sample time, s; the model's by default.
    gain_margin
        Least gain margin, dB.
    phase_margin
        Least phase margin, degrees.
    peak_sensitivity
        Greatest peak of the sensitivity |S|.
    loop_delay
        Further delay of the loop, ticks.
    gain_spread
        Relative spread of the plant's gain, over which the margins hold too.
    mode_spread
        Relative spread of the resonances' frequencies, all together and each by itself, over which the margins hold too.
    model_error
        Relative error of the model's response at any frequency, on top of the spreads: a motion of the model is wrong by this share of
        its size, in any direction. Gain and phase margins of axes that drive each other hold for errors that all of them share.
    roll_off
        Corner of the feedback's roll-off, Hz; 0 for none, "auto" to choose it along with the gains, which then keep the margins
        only with it.
    structure
        "pi"; "pid" with a derivative behind a low-pass; "notch" at the resonance that peaks most in the loop; "damping" of that resonance;
        or "auto" for the best of them. The margins hold only with these filters.

    Returns
    -------
    Tuning
        Gains, roll-off and the properties of the loop.

    Raises
    ------
    InputError
        The model is an inverse one, a parameter is out of its range, or no controller keeps the margins.
    """
    if model.units["measurement"] == "V" and model.units["command"] in ("um", "mrad"):
        raise InputError(f"{model.name}: is an inverse model, from {model.units['command']} to V: give the model of the machine")
    sample_time = float(sample_time or model.sample_time)
    spreads = gain_spread, mode_spread, model_error
    given = gain_margin, phase_margin, peak_sensitivity, loop_delay, *spreads, roll_off, structure
    for asked, value in zip(ASKED, given, strict=True):
        asked.checked(value)
    mean, greatest = hysteresis_slopes(model)
    stages, axes = linearized(model, mean), len(model.axes)
    ringing = _loop_peaks(linearized(model, greatest), axes, sample_time)
    mode = complex(ringing.poles[0]) if len(ringing.poles) else None
    limits = 10.0 ** (gain_margin / 20.0), np.radians(phase_margin), peak_sensitivity, model_error

    def step(law: PI) -> Step:
        return linear_step(stages, axes, law, loop_delay)

    def ranked(plants: Plants, static: float) -> list[Shape]:
        tried = shapes(structure, None if roll_off == AUTOMATIC else float(roll_off), static, mode, sample_time)
        if len(tried) == 1:
            return tried
        few = plants.part(every=3)  # the least absolute error of the step first; a third of the frequencies ranks them
        coarse = [(shape, law) for shape in tried if (law := _greatest_integral(few, static, sample_time, shape, limits))]
        return [shape for shape, law in sorted(coarse, key=lambda pair: step(pair[1]).absolute_error)]

    def search(plants: Plants, order: list[Shape]) -> tuple[PI, list[Shape]]:
        static = float(np.abs(plants.loci[:, 0]).max())
        if np.any(plants.loci[:, 0].real <= 0.0):
            raise InputError("chain: the output falls when the command rises at rest: PI gains are positive; invert the axis")
        order = order or ranked(plants, static)
        for shape in order:
            if law := _greatest_integral(plants, static, sample_time, shape, limits):
                return law, order
        decouple = ", or decouple the axes, which drive each other" if plants.mixed else ""
        tiny = PI(0.0, 10.0 / float(np.abs(plants.loci[:, 0] / (1.0 - 1.0 / z[0])).min()) / sample_time, sample_time, -1e300, 1e300)
        why = _violated(plants, controller_response(tiny, z), sample_time, limits)
        raise InputError(
            f"margins: no controller of this structure keeps them for this model{f' ({why} at any gain)' if why else ''}: ask for "
            f"less, or sample faster{decouple}"
        )

    known, least, dynamic = known_band(model), 0.0, has_dynamics(stages, axes)
    lowest = LOWEST * (1e-3 if Plants.nominal(model, sample_time, loop_delay, np.array([1j])).mixed else 1.0)

    def cases(alone: Complex) -> Plants:
        found = spread_responses(model, sample_time, loop_delay, gain_spread, mode_spread, z, alone.tolist())
        return Plants(z, found, beyond & (not dynamic))

    while least < 1.0:  # from where the integral action prevails
        z = _points(modes(stages, axes), ringing.poles, mode_spread, sample_time, lowest)
        beyond = np.angle(z) > 2.0 * np.pi * sample_time * known * (1.0 + 1e-9)
        plants = cases(np.empty(0, complex))
        law, order = search(plants, [])
        least = float(np.abs(plants.loci[:, 0] * controller_response(law, z)[0]).min()) * (1.0 - model_error)
        lowest *= 0.1 * least
    if len(ringing.poles) > 1 and mode_spread:  # the gains for modes that move together mostly suit those that move each by itself
        heard = np.abs(controller_response(law, np.exp(1j * ringing.poles.imag * sample_time))) * ringing.peaks
        plants = cases(ringing.poles[heard > model_error / peak_sensitivity])
        if not plants.margins(controller_response(law, z), sample_time, model_error).keep(
            gain_margin, phase_margin, peak_sensitivity
        ):
            law, _ = search(plants, order)
    controller = controller_response(law, z)
    found = step(law)
    settling = found.settling_ticks() * sample_time
    if np.isnan(settling):
        raise InputError(
            "chain: is not stable, so that no step settles however large its margins: identify the model again, or mend its dynamics"
        )
    nominal, worst = plants.part(1).margins(controller, sample_time), plants.margins(controller, sample_time, model_error)
    reached = dynamic and np.abs(plants.loci * controller)[:, beyond].max(initial=0.0) * (1.0 + model_error) * limits[0] > 1.0
    notes = _notes(plants, known, model_error, dynamic, reached)

    @cache
    def bandwidth_without(count: int) -> float:
        """Bandwidth (Hz) of a PI loop whose first so many resonances are well damped."""
        few = plants.part(every=3)
        quiet = spread_responses(
            model, sample_time, loop_delay, gain_spread, mode_spread, few.z, quiet=ringing.poles[:count].tolist()
        )
        damped = replace(few, responses=quiet)
        static = float(np.abs(damped.loci[:, 0]).max())
        pi = _greatest_integral(damped, static, sample_time, Shape(), limits)
        return damped.part(1).margins(controller_response(pi, few.z), sample_time).bandwidth if pi else 0.0

    notes += _held_back(ringing, nominal.bandwidth, bandwidth_without, structure)
    if structure == "damping" and not law.filters.damping_gain:
        tried = next(shape for shape in shapes(structure, 0.0, 1.0, mode, sample_time) if shape.damping_gain)
        least_damping = replace(tried, damping_gain=tried.damping_gain / float(np.abs(plants.loci[:, 0]).max()))
        why = _violated(plants, controller_response(least_damping.law(0.0, 0.0, 0.0, sample_time), z), sample_time, limits)
        notes += (f"No damping is used: the gains are those of PI alone{f' (the least damping tried: {why})' if why else ''}.",)
    return Tuning(law.kp, law.ki, sample_time, nominal, worst, settling, found.overshoot, law.roll_off, law.filters, notes)


def known_band(model: Model) -> float:
    """Highest frequency, Hz, that a model tells of: where the power of its records' commands ends, at most half its own sample rate."""
    excited = np.asarray(model.valid.get("frequency", [0.0, np.inf]), dtype=float)[..., 1]
    return min(float(excited.min()), 0.5 / model.sample_time)


def _notes(plants: Plants, known: float, error: float, dynamic: bool, reached: bool) -> tuple[str, ...]:
    """Sentences on what the margins rest on: the band that the model tells of, and whether the loop reaches beyond it."""
    found = []
    greatest, least = (float(size[0, 0]) for size in plants.sizes)
    if plants.mixed and least < error * greatest:
        found.append(
            f"The axes have {least / greatest:.2g} of their greatest gain in the direction in which they move least. The model error is a "
            "share of the motion: one of this share of the greatest gain can reverse that direction, which no integral action survives."
        )
    if not dynamic:
        kept = f": the loop's gain is kept below {UNKNOWN:g} there" if plants.unknown.any() else ""
        found.append(
            f"The model has no dynamics, and no data above {known:.4g} Hz{kept}. For a faster loop identify dynamics from faster "
            "commands."
        )
    elif reached:
        found.append(f"No data above {known:.4g} Hz: the margins extrapolate. Identify the model from faster commands.")
    return tuple(found)


def _held_back(ringing: Resonances, bandwidth: float, without: Callable[[int], float], structure: str) -> tuple[str, ...]:
    """Sentence on the fewest resonances, in the order of their peaks, without which a loop would be much faster."""
    poles = ringing.poles
    if not len(poles) or without(len(poles)) < MUCH * bandwidth:
        return ()
    few = next((count for count in range(1, min(len(poles), NAMED)) if without(count) >= MUCH * bandwidth), min(len(poles), NAMED))
    reached, others = without(few), ""
    if reached < MUCH * bandwidth:
        reached, others = without(len(poles)), " and others"
    places = [f"{abs(pole) / (2.0 * np.pi):.4g} Hz (damping ratio {-pole.real / abs(pole):.2g})" for pole in poles[:few]]
    several = few > 1 or others
    advice = (
        "Damp the machine" if structure == AUTOMATIC else "Try a roll-off, or the structure auto, which compares notch and damping"
    )
    return (
        f"The resonance{'s' if several else ''} at {', '.join(places)}{others} limit{'' if several else 's'} the loop to a bandwidth of "
        f"{bandwidth:.3g} Hz. Well damped, PI alone would reach about {float(f'{reached:.2g}'):g} Hz. {advice}.",
    )


def _violated(plants: Plants, controller: Complex, sample_time: float, limits: Limits) -> str:
    """Margin that loops with a controller (F,) do not keep, with its frequency; empty where all are kept."""
    gain_margin, phase_margin, peak_sensitivity, error = limits
    frequency = np.angle(plants.z) / (2.0 * np.pi * sample_time)
    sensitivity, complementary = plants.sensitivities(controller)
    distance = ((1.0 - error * complementary) / sensitivity).min(axis=0)  # below 0 where an error may reach -1
    found, loops = plants.margins(controller, sample_time, error), plants.loci * controller
    if distance.min() * peak_sensitivity < 1.0:
        peak = f"{1.0 / distance.min():.3g}" if distance.min() > 0.0 else "without bound"
        return f"peak sensitivity {peak} at {frequency[distance.argmin()]:.4g} Hz"
    if found.gain_margin < 20.0 * np.log10(gain_margin):
        crossed = np.append(loops.imag[:, :-1] * loops.imag[:, 1:] <= 0.0, np.ones((len(loops), 1), bool), axis=1)
        at = np.where(crossed, -loops.real, 0.0).max(axis=0).argmax()
        return f"gain margin {found.gain_margin:.3g} dB at {frequency[at]:.4g} Hz"
    if found.phase_margin < np.degrees(phase_margin):
        return f"phase margin {found.phase_margin:.3g} degrees at {found.crossover:.4g} Hz"
    return ""


def _loop_peaks(stages: Sequence[Stage], axes: int, sample_time: float) -> Resonances:
    """Resonances below half the sampling rate with their peaks in V^-1, the one first that peaks most in a loop of integral action."""
    found = resonances(stages, axes)
    below = found.poles.imag * sample_time < np.pi
    poles, z = found.poles[below], np.exp(1j * found.poles.imag[below] * sample_time)
    peaks = found.peaks[below] * np.linalg.norm(sampled_response(stages, axes, sample_time, z), axis=(1, 2))
    order = np.argsort(-peaks / np.abs(poles))
    return Resonances(poles[order], peaks[order])


def _points(poles: Complex, ringing: Complex, mode_spread: float, sample_time: float, lowest: float) -> Complex:
    """Points of the unit circle up to half the sampling rate: evenly, and close by every pole, those that ring where they may be."""
    angles = [np.geomspace(LOWEST, 1.0, 1500) * np.pi]
    if lowest < LOWEST:
        angles.append(np.geomspace(lowest, LOWEST, 2 + int(300 * np.log10(LOWEST / lowest))) * np.pi)
    for pole in poles:
        steps = np.geomspace(min(0.1 * abs(pole.real) / abs(pole), 0.1) + 1e-9, 0.1, AROUND)
        places = np.concatenate([1.0 - steps, [1.0], 1.0 + steps]) * pole.imag * sample_time
        angles += [places * factor for factor in ((1.0 - mode_spread, 1.0, 1.0 + mode_spread) if pole in ringing else (1.0,))]
    every = np.unique(np.concatenate(angles))
    return np.asarray(np.exp(1j * every[(every > 0.0) & (every <= np.pi)]), dtype=np.complex128)


Limits = tuple[float, float, float, float]
"""Least gain margin as a factor, phase margin in rad, greatest peak of the sensitivity, relative model error."""


def _greatest_integral(plants: Plants, static: float, sample_time: float, shape: Shape, limits: Limits) -> PI | None:
    """The law of a shape with the greatest ki that keeps the limits for all plants; None where there is none."""
    unit, z = shape.law(0.0, 0.0, 0.0, sample_time), plants.z
    before, beside = law_sections(unit)
    passed = np.prod([np.ones_like(z), *(response(section, z) for section in before)], axis=0)
    fixed = passed * sum(response(section, z) for section in beside)  # damping alone
    filtered = bool(before)
    if unit.filters.damping_gain and not _damped(plants, fixed, limits):
        return None
    (derivative,) = Filters(kd=1.0, derivative_corner=shape.derivative_corner).beside(sample_time)
    best: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Integral action alone, and proportional-to-integral times from a tenth of a sample to ten thousand.
    times = [0.0, *(sample_time * np.geomspace(0.1, 1e4, 26 if shape.several else 51))] if shape.time is None else [shape.time]
    for time in times:
        advance = shape.derivative * time**2
        scaled = (time + sample_time * z / (z - 1.0) + advance * response(derivative, z)) / (static * sample_time)
        controller, above = passed * scaled, best[1] * static * sample_time
        compared = filtered and above and not shape.damping_gain
        if compared and phase_margin_of(courses_of(plants.loci * controller), limits[3], above).min() < limits[1]:
            continue  # no greater integral gain than the best so far
        scale = _largest_scale(plants, controller, limits, above, fixed if shape.damping_gain else None)
        slope = static * sample_time
        gains = (scale * time / slope, scale / slope, scale * advance / slope)
        if gains[1] > best[1]:
            best = gains
    return shape.law(float(best[0]), float(best[1]), float(best[2]), sample_time) if best[1] > 0.0 else None


def _damped(plants: Plants, damping: Complex, limits: Limits) -> bool:
    """True when the loops of the damping (F,) alone keep the limits at every gain up to theirs."""
    gain_margin, phase_margin, peak, error = limits
    fixed = plants.loci * damping
    crossing = np.maximum(crossing_180(fixed), -fixed.real[:, 0]).max() * (1.0 + error) * gain_margin
    return bool(
        crossing <= 1.0
        and 1.0 <= peak * plants.distance(damping, error)
        and phase_margin_of(courses_of(fixed), error).min() >= phase_margin
    )


def controller_response(law: PI, z: Complex) -> Complex:
    """Response (F,) of the feedback from the error to the command at points of the z plane, V per measurement unit."""
    before, beside = law_sections(law)
    passed = np.prod([np.ones_like(z), *(response(section, z) for section in before)], axis=0)
    return np.asarray(passed * np.sum([response(section, z) for section in beside], axis=0))


def _largest_scale(plants: Plants, controller: Complex, limits: Limits, above: float, fixed: Complex | None) -> float:
    """The largest factor on a controller (F,), beside a `fixed` one, up to which loops keep the margins; 0 if not more than `above`."""
    gain_margin, phase_margin, peak_sensitivity, error = limits
    loops = plants.loci * controller
    ultimate = crossing_180(loops).max() * (1.0 + error)
    highest = 1.0 / (max(ultimate, 1e-12) * gain_margin)
    if fixed is not None:  # the damping may allow more than the plant does
        highest *= 10.0
    if plants.unknown.any():
        highest = min(highest, UNKNOWN / float(np.abs(loops[:, plants.unknown]).max()))
    courses, enough = courses_of(loops), 1.0 / peak_sensitivity

    def kept(scale: float) -> bool:
        whole = scale * controller if fixed is None else scale * controller + fixed
        if 1.0 > peak_sensitivity * plants.distance(whole, error, enough):
            return False
        if fixed is None:
            return bool(phase_margin_of(courses, error, scale).min() >= phase_margin)
        scaled = plants.loci * whole
        if crossing_180(scaled).max() * (1.0 + error) * gain_margin > 1.0:
            return False
        return bool(phase_margin_of(courses_of(scaled), error).min() >= phase_margin)

    if highest <= above:
        return 0.0
    # A resonance may take the phase margin or the sensitivity long before the gain margin: begin where everything is kept.
    lowest = 1e-2
    # How much mixed axes amplify remains the same at less gain: it is not looked for below the frequencies.
    least = 1.0 / (highest * np.abs(loops[:, 0]).min()) if plants.mixed else LOWEST_SCALE
    while not kept(highest * lowest):
        lowest *= 0.1
        if lowest < least:
            return 0.0
    last = 0.0
    for scale in highest * np.geomspace(lowest, 1.0, 25 + int(round(12 * np.log10(1e-2 / lowest)))):
        if not kept(scale):
            break
        last = float(scale)
    else:
        return last
    high = float(scale)
    if high <= above:
        return 0.0
    for _ in range(8):
        middle = 0.5 * (last + high)
        last, high = (middle, high) if kept(middle) else (last, middle)
    return last
