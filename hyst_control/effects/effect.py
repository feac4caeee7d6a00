# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects as a simulator knows them: a stage, the place in the chain where it goes, and what its parameters usually are.

One file in this package is one effect. It defines the effect's stage where the chain has none yet, and `EFFECT`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from hyst_control.base.arrays import Array
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
    """Record that the size of an effect is judged by."""

    sample_time: float  # s
    duration: float  # s
    command: tuple[float, float]  # (lower, upper) of the record, in its unit
    slew: float  # The largest of the command, in its unit per s
    measurement: tuple[float, float]  # (lower, upper) of the record, in its unit
    axes: int
    lowest_frequency: float = 1.0  # Lowest frequency that the command excites, Hz
    beside_error: bool = False  # Whether the model discrepancy is known
    # Frequency (Hz) and damping of every mode of the nominal mechanics, where these drive the axes together; a damping above
    # 1 stands for two real poles
    modes: tuple[tuple[float, float], ...] = ()
    begin: float = 0.0  # s from the start of the record to the first sample that is compared
    moved: float = 0.0  # s from the start of the record to the first sample that is compared at which the command has moved
    # Range of what the nominal model simulates on the record, in the measurement's unit; None where that is not known
    modeled: tuple[float, float] | None = None
    # Of the nominal mechanics, 1/s, where these drive the axes together: real ones, and one of every conjugate pair, in order
    # of size
    poles: tuple[complex, ...] = ()
    # Candidates for a hold of the command, estimated from the gap: number of samples, and phase
    holds: tuple[tuple[int, int], ...] = ()

    @property
    def stroke(self) -> float:
        """Peak to peak of the measurement, in its unit."""
        return self.measurement[1] - self.measurement[0]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: where fits begin, its bounds and its prior."""

    name: str  # By which the gap report has it
    unit: str  # "" (a share), "s", "Hz", "unit" for that of the measurement, "command" for that of the command, or "command/s"
    absent: float  # Value at which the effect is not there
    starts: tuple[float, ...]  # Where fits begin
    lower: float
    upper: float
    # A usual deviation from `absent` (of its natural logarithm where `logarithmic`): the standard deviation of a broad prior
    scale: float
    logarithmic: bool = False  # Whether its logarithm is what is fitted
    told: bool = True  # Whether the gap report has it; otherwise it only stands in the augmented model
    # Whether its starts are what the effect's record check suggests, where that suggests any; each then stands for values
    # nearby, of which the one that comes closest to the record is where a fit begins
    suggested: bool = False
    # Index of the one sensor that sees it, of a parameter in which the mechanics' output is linear; None of any other
    sensor: int | None = None
    response: str = ""  # Of such a parameter: those of one response differ in their sensor only, and one simulation shows them all
    # Change over which the output is nearly straight in it, in its unit, where that is less than a fiftieth of the scale; 0
    # otherwise
    smooth: float = 0.0
    # Whether it is a size of the effect, as the first parameter always is: at an end of its range the effect is not known
    is_size: bool = False


@dataclass(frozen=True)
class Line:
    """An effect that is lines in the residual's spectrum, whose amplitudes and phases are fitted at frequencies seen there."""

    harmonics: tuple[int, ...] = (1,)  # Those that are fitted, each with its own amplitude and phase
    swells: int = 1  # Number of Legendre polynomials over the record by which amplitude and phase may change
    skirt: float = 0.0  # Share of the frequency on either side that is the effect's own
    overtones: tuple[int, ...] = ()  # Harmonics that are not fitted, about which a skirt is the effect's own as well


@dataclass(frozen=True)
class Companion:
    """An effect that is a Legendre polynomial over the record: its degree, and `parameter` = factor · the polynomial's coefficient."""

    degree: int
    parameter: str
    factor: float = 1.0
    # A realization that fits this parameter is no such polynomial, and so not part of a session
    beyond: str = ""


@dataclass(frozen=True)
class Effect:
    """An effect by its name in the gap report."""

    name: str  # In the gap report's vocabulary
    place: str  # One of `PLACES`; an effect that may be at several has its usual one
    meaning: str  # One sentence for people
    parameters: Callable[[Surroundings], tuple[Parameter, ...]]  # Of a record's surroundings
    stage: Callable[[Values, Surroundings], Stage]  # The stage for parameter values and surroundings
    exercised: Callable[[Surroundings], bool] = lambda _: True  # Whether a record could show the effect at all
    # Whether the measurement repeats a value while the effect holds it, which is then no sample that was held
    repeats_values: bool = False
    # Simpler effect that it becomes at an end of its ranges: no second explanation where that one explains a record better
    ends_as: str | None = None
    static: bool = False  # Whether it is a share of a motion, the same at every frequency
    # Whether it is such a share where the command does not reach a frequency of its own: one that leaves hardly more than noise is named
    static_elsewhere: bool = False
    # Whether it has a waveform that a simulation can be compared with; noise, lattices and repeated samples have none and are found
    # by looking at the record
    waveform: bool = True
    couples: bool = False  # Whether it needs a second axis
    shared: bool = False  # Whether coupled axes have it in common, as they have their modes
    # Whether each of the axes that a plant mixes may have a size of its own, of one cause: their amplifiers or sensors differ
    separate_sizes: bool = False
    # Parameters on all axes of a plant that mixes them, where these are others
    coupled_parameters: Callable[[Surroundings], tuple[Parameter, ...]] | None = None
    # Realizations that differ in numbers that are not fitted, such as an order, a phase or a manner of rounding: values of
    # these numbers, each tried with the effect's other parameters fitted. Values of all parameters leave nothing to fit
    variants: Callable[[Surroundings], tuple[Mapping[str, float], ...]] = lambda _: ({},)
    # Whether a realization differs from a simpler effect on these commands, each (N, A)
    distinct: Callable[[Mapping[str, float], Sequence[Array]], bool] = lambda *_: True
    summary: Callable[[Values], dict[str, float]] = lambda _: {}  # What the gap report has of parameters that are not told
    # The values that the gap report has, beside the model's stages: where the same number is another effect in each realization
    reported: Callable[[Values, Surroundings, Sequence[Stage]], Values] = lambda values, *_: values
    line: Line | None = None  # Of an effect that is one in the spectrum
    further_lines: tuple[Line, ...] = ()  # Other shapes that it may have there
    # The check that finds an effect without a waveform, and measures its one parameter; of an effect with a waveform the
    # check that suggests its frequencies, or the starts of its `suggested` parameter
    record_check: RecordCheck | None = None
    random_check: RecordCheck | None = None  # The check that finds an effect with a waveform where it is at random, and has none
    # What to record besides where no excitation tells it from another effect; None: another sensor
    separating_record: str | None = None
    # Of an effect that differs from session to session, and so is free in every hypothesis where baseline records are at hand
    companion: Companion | None = None
    also_at: tuple[str, ...] = ()  # Further places that an engineer would call by the same name
    # The same, where the signatures differ only beside baseline records, whose own error does not go through the drive
    also_beside_clean: tuple[str, ...] = ()
    # The effect in the middle of a sentence, with parameters that the gap report has in braces: "a slew limit of {rate}"; "":
    # its name
    phrase: str = ""

    def checked_parameter(self, around: Surroundings) -> Parameter:
        """The parameter that the record check measures around a record: the one that a check suggests, or its first."""
        every = self.parameters(around)
        return next((parameter for parameter in every if parameter.suggested), every[0])
