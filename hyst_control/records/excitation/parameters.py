# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of all kinds of signals, declared once: the descriptions that the reference generator and the documents give."""

from __future__ import annotations

from hyst_control.base.quantity import NUMBER, Quantity

UNIT = "signal unit"

COMMON = {
    "lower": (UNIT, "Lowest value that the signal may have"),
    "upper": (UNIT, "Highest value that the signal may have"),
    "slew_limit": ("signal unit/s", "Greatest rate that the signal may have"),
    "axis": ("", "Index of the axis that moves; all if not given"),
    "idle": (UNIT, "Value of the other axes"),
}
"""Unit and meaning of what every kind takes."""
OF_SIGNALS = {
    "after": ("s", "Time after the step"),
    "amplitude": (UNIT, "Amplitude"),
    "amplitudes": (UNIT, "Amplitudes (F,)"),
    "avoid_mains": ("", "True to leave out lines within one line of a multiple of 50 or 60 Hz"),
    "band": ("Hz", "Highest frequency of the small multisine; 0.35 of the sample rate at most"),
    "before": ("s", "Time before the step"),
    "count": ("", "Number of random levels, drawn from a uniform distribution"),
    "cycles": ("", "Number of loops; the length is rounded to whole samples"),
    "detection": ("", "Size of the groups of lines of which one is left out; 0 or 1 for none"),
    "duration": ("s", "Length"),
    "fast_share": ("", "Part of the peak that loops above 300 Hz reach, to spare the amplifier"),
    "final": (UNIT, "Amplitude at the end"),
    "frequencies": ("Hz", "Frequencies (F,)"),
    "frequency": ("Hz", "Frequency"),
    "height": (UNIT, "Height"),
    "highest": (UNIT, "Highest level"),
    "hold": ("s", "Time at each level"),
    "join": ("s", "Time of the half cosine that joins two signals without a jump; 0 for none"),
    "levels": (UNIT, "Levels (L,)"),
    "line_time": ("s", "Time of one pass"),
    "lines": ("", "Number of passes of axis 0"),
    "logarithmic": ("", "True for equal time per octave, False for a frequency that changes linearly"),
    "lower_frequency": ("Hz", "Lowest frequency"),
    "lowest": (UNIT, "Lowest level"),
    "odd": ("", "True to excite odd harmonics only"),
    "offset": (UNIT, "Mean"),
    "parts": ("", "Descriptions of the signals, as for `build`"),
    "pause": ("s", "Rest after each group of loops"),
    "peak": (UNIT, "Greatest value"),
    "period": ("s", "Period; a whole number of samples"),
    "periods": ("", "Number of periods"),
    "phase": ("rad", "Phase at the first sample; -π/2 starts at the lowest point"),
    "phases": ("rad", "Phases (F,); all 0 by default"),
    "quasi_static": ("Hz", "Frequency of the quasi-static loops"),
    "radius": (UNIT, "Radius at the end"),
    "ramp": ("s", "Time of the half cosine from one level to the next; 0 for a jump"),
    "rms": (UNIT, "Root mean square about the offset"),
    "seed": ("", "Seed of what is drawn at random"),
    "slow": ("Hz", "Frequency of the slow loops"),
    "start": (UNIT, "First value"),
    "start_frequency": ("Hz", "Frequency at the beginning"),
    "step_height": ("V", "Height of the step"),
    "stop": (UNIT, "Value that the sample after the last one would have"),
    "stop_frequency": ("Hz", "Frequency at the end"),
    "sweep_time": ("s", "Length of each sweep"),
    "time": ("s", "Time at every frequency; three loops at least"),
    "upper_frequency": ("Hz", "Highest frequency"),
    "width": (UNIT, "Width"),
}
OF_KINDS = {
    ("decaying_sine", "amplitude"): (UNIT, "Amplitude at the beginning"),
    ("diagnostic", "duration"): ("s", "Approximate length"),
    ("diagnostic", "highest"): ("V", "Highest command"),
    ("diagnostic", "lowest"): ("V", "Lowest command"),
    ("hampi_identification", "frequencies"): ("Hz", "Frequencies (F,) of the faster loops"),
    ("hampi_identification", "peak"): ("V", "Greatest command"),
    ("mhl_identification", "highest"): ("Hz", "Highest frequency of the small sweep; 0.4 of the sample rate at most"),
    ("mhl_identification", "peak"): ("V", "Greatest command"),
    ("raster", "offset"): (UNIT, "Center"),
    ("rest", "offset"): (UNIT, "Value"),
    ("spiral", "frequency"): ("Hz", "Turns per second"),
    ("spiral", "offset"): (UNIT, "Center"),
    ("step", "offset"): (UNIT, "Value before the step"),
}
"""Those that mean something else in one kind."""


def described(kind: str, name: str) -> Quantity:
    """Unit and meaning of a parameter of a kind of signal, without a default."""
    unit, meaning = OF_KINDS.get((kind, name)) or OF_SIGNALS.get(name) or COMMON[name]
    return Quantity(name, None, unit, meaning, kind=NUMBER)
