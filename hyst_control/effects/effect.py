# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects as a simulator knows them: a stage, the place in the chain where it goes, and what its parameters usually are.

One file in this package is one effect. It defines the effect's stage where the chain has none yet, and `EFFECT`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from hyst_control.chain.stage import Stage

PLACES = ("dac", "drive", "hysteresis", "piezo", "mechanics", "motion", "sensor", "adc", "transport")
"""In signal order."""


class RecordCheck(Enum):
    """Check of a record by which an effect is found, or by which the frequencies are found at which it is fitted."""

    REPEATED_VALUES = "repeated_values"
    VALUE_LATTICE = "value_lattice"
    WHITE_SPECTRUM = "white_spectrum"
    FALLING_SPECTRUM = "falling_spectrum"
    MAINS_LINE = "mains_line"
    COMMAND_LATTICE = "command_lattice"
    SPECTRAL_LINE = "spectral_line"
    SPECTRAL_HUMP = "spectral_hump"

    @property
    def is_noise(self) -> bool:
        """True where noise is what it finds: that raises the model's noise, and is no stage of the chain."""
        return self in (RecordCheck.WHITE_SPECTRUM, RecordCheck.FALLING_SPECTRUM, RecordCheck.SPECTRAL_HUMP)

    @property
    def is_of_the_record(self) -> bool:
        """True where what it finds is in the recorded command only, so that the chain gets no stage for it."""
        return self is RecordCheck.COMMAND_LATTICE


Values = Mapping[str, Any]
"""Parameter values by name: a number for every axis alike, or a list with one per axis."""


@dataclass(frozen=True)
class Surroundings:
    """Record that the size of an effect is judged by.

    Parameters
    ----------
    sample_time
        s.
    duration
        s.
    command
        (lower, upper) V of the record.
    slew
        V/s, the largest of the command.
    measurement
        (lower, upper) of the record, in its unit.
    axes
        Their number.
    slowest
        Lowest frequency (Hz) that the command excites, where clean records keep the model's own error apart, so that effects may be
        as large as physics allows; None where they do not.
    modes
        Frequency (Hz) and damping of every mode of the nominal mechanics, where these drive the axes together; a damping above 1
        stands for two real poles.
    begin
        s from the start of the record to the first sample that is compared.
    moved
        s from the start of the record to the first sample that is compared at which the command has moved.
    modeled
        Range of what the nominal model simulates on the record, in the measurement's unit; None where that is not known.
    poles
        Of the nominal mechanics, 1/s, where these drive the axes together: real ones, and one of every conjugate pair, in order of size.
    """

    sample_time: float
    duration: float
    command: tuple[float, float]
    slew: float
    measurement: tuple[float, float]
    axes: int
    lowest_frequency: float | None = None
    modes: tuple[tuple[float, float], ...] = ()
    begin: float = 0.0
    moved: float = 0.0
    modeled: tuple[float, float] | None = None
    poles: tuple[complex, ...] = ()

    @property
    def stroke(self) -> float:
        """Peak to peak of the measurement, in its unit."""
        return self.measurement[1] - self.measurement[0]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: where fits begin, its bounds and its prior.

    Parameters
    ----------
    name
        By which the gap report has it.
    unit
        "" (a share), "s", "Hz", "V", "V/s", or "unit" for that of the measurement.
    absent
        Value at which the effect is not there.
    starts
        Where fits begin.
    lower, upper
        Bounds.
    scale
        A usual deviation from `absent` (of its natural logarithm where `logarithmic`): the standard deviation of a broad prior.
    logarithmic
        Whether its logarithm is what is fitted.
    told
        Whether the gap report has it; otherwise it only stands in the augmented model.
    suggested
        Whether its starts are what the effect's record check suggests, where that suggests any; each then stands for values
        nearby, of which the one that comes closest to the record is where a fit begins.
    sensor
        Index of the one sensor that sees it, of a parameter in which the mechanics' output is linear; None of any other.
    response
        Of such a parameter: those of one response differ in their sensor only, and one simulation shows them all.
    smooth
        Change over which the output is nearly straight in it, in its unit, where that is less than a fiftieth of the scale; 0 otherwise.
    is_size
        Whether it is a size of the effect, as the first parameter always is: at an end of its range the effect is not known.
    """

    name: str
    unit: str
    absent: float
    starts: tuple[float, ...]
    lower: float
    upper: float
    scale: float
    logarithmic: bool = False
    told: bool = True
    suggested: bool = False
    sensor: int | None = None
    response: str = ""
    smooth: float = 0.0
    is_size: bool = False


@dataclass(frozen=True)
class Line:
    """An effect that is lines in the residual's spectrum, whose amplitudes and phases are fitted at frequencies seen there.

    Parameters
    ----------
    harmonics
        Those that are fitted, each with its own amplitude and phase.
    swells
        Number of Legendre polynomials over the record by which amplitude and phase may change.
    skirt
        Share of the frequency on either side that is the effect's own.
    overtones
        Harmonics that are not fitted, about which a skirt is the effect's own as well.
    """

    harmonics: tuple[int, ...] = (1,)
    swells: int = 1
    skirt: float = 0.0
    overtones: tuple[int, ...] = ()


@dataclass(frozen=True)
class Companion:
    """An effect that is a Legendre polynomial over the record: its degree, and `parameter` = factor · the polynomial's coefficient."""

    degree: int
    parameter: str
    factor: float = 1.0


@dataclass(frozen=True)
class Effect:
    """An effect by its name in the gap report.

    Parameters
    ----------
    name
        In the gap report's vocabulary.
    place
        One of `PLACES`; an effect that may be at several has its usual one.
    meaning
        One sentence for people.
    parameters
        Of a record's surroundings.
    stage
        The stage for parameter values and surroundings.
    exercised
        Whether a record could show the effect at all.
    repeats_values
        Whether the measurement repeats a value while the effect holds it, which is then no sample that was held.
    ends_as
        Simpler effect that it becomes at an end of its ranges: no second explanation where that one explains a record better.
    waveform
        Whether it has one that a simulation can be compared with; noise, lattices and repeated samples have none and are found by
        looking at the record.
    couples
        Whether it needs a second axis.
    shared
        Whether coupled axes have it in common, as they have their modes.
    apart
        Whether each of the axes that a plant mixes may have a size of its own, of one cause: their amplifiers or sensors differ.
    coupled_parameters
        On all axes of a plant that mixes them, where these are others.
    summary
        What the gap report has of parameters that are not told.
    line
        Of an effect that is one in the spectrum.
    further_lines
        Other shapes that it may have there.
    record_check
        The check that finds an effect without a waveform, and measures its one parameter; of an effect with a waveform the check
        that suggests its frequencies, or the starts of its `suggested` parameter.
    random_check
        The check that finds an effect with a waveform where it is at random, and has none.
    variants
        Realizations that differ in numbers that are not fitted, such as an order, a phase or a manner of rounding: values of
        these numbers, each tried with the effect's other parameters fitted. Values of all parameters leave nothing to fit.
    separating_record
        What to record besides where no excitation tells it from another effect; None: another sensor.
    companion
        Of an effect that differs from session to session, and so is free in every hypothesis where clean records are at hand.
    also_at
        Further places that an engineer would call by the same name.
    also_beside_clean
        The same, where the signatures differ only beside clean records, whose own error does not go through the drive.
    phrase
        The effect in the middle of a sentence, with parameters that the gap report has in braces: "a slew limit of {rate}"; "": its
        name.
    """

    name: str
    place: str
    meaning: str
    parameters: Callable[[Surroundings], tuple[Parameter, ...]]
    stage: Callable[[Values, Surroundings], Stage]
    exercised: Callable[[Surroundings], bool] = lambda _: True
    repeats_values: bool = False
    ends_as: str | None = None
    waveform: bool = True
    couples: bool = False
    shared: bool = False
    separate_sizes: bool = False
    coupled_parameters: Callable[[Surroundings], tuple[Parameter, ...]] | None = None
    variants: Callable[[Surroundings], tuple[Mapping[str, float], ...]] = lambda _: ({},)
    summary: Callable[[Values], dict[str, float]] = lambda _: {}
    line: Line | None = None
    further_lines: tuple[Line, ...] = ()
    record_check: RecordCheck | None = None
    random_check: RecordCheck | None = None
    separating_record: str | None = None
    companion: Companion | None = None
    also_at: tuple[str, ...] = ()
    also_beside_clean: tuple[str, ...] = ()
    phrase: str = ""

    def checked_parameter(self, around: Surroundings) -> Parameter:
        """Select the parameter that the effect's record check measures: the one that a check suggests, or its first.

        Parameters
        ----------
        around
            Record that the sizes are judged by.

        Returns
        -------
        Parameter
        """
        every = self.parameters(around)
        return next((parameter for parameter in every if parameter.suggested), every[0])
