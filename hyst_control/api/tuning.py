# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tunings of the feedback for scripts and notebooks."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyst_control import model_file
from hyst_control.api.model import model_of
from hyst_control.api.shown import Shown, drawn, promoted, step_of, table_frame
from hyst_control.control import tuning
from hyst_control.control.jitter import Jitter, jitter
from hyst_control.control.model_figures import tuning_panels
from hyst_control.records import record as records

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Tuning(tuning.Tuning, Shown):
    """Gains of the PI feedback and what they give.

    Parameters
    ----------
    kp, ki, sample_time, nominal, worst, settling_time, overshoot, roll_off, filters, notes
        Gains (V per measurement unit, and per s), sample time (s), margins of the model and of the worst case, settling time (s) and
        overshoot (%) of a step, corner of the roll-off (Hz, 0 without), derivative, notches and damping, and what the margins rest on.
    model
        Model that they were tuned for.
    loop_delay
        Further delay of the loop, ticks.

    Examples
    --------
    >>> gains = hc.tune(model, rate=1000)
    >>> gains.worst.gain_margin >= 6, gains.worst.phase_margin >= 45
    (True, True)
    >>> len(gains.plot())                               # open loop, phase, sensitivities, step
    4
    """

    model: model_file.Model = field(kw_only=True)
    loop_delay: int = field(default=0, kw_only=True)

    def summary(self) -> str:
        """Gains, margins and step as a table."""
        return self.table(self.model).text()

    def to_frame(self) -> Any:
        """The table as a pandas DataFrame."""
        return table_frame(self.table(self.model))

    def jitter(self, record: records.Record) -> Jitter:
        """Predict the motion at rest with this feedback, by decades of frequency, from a record without feedback.

        Parameters
        ----------
        record
            Record of the measurement while the command rests.

        Returns
        -------
        Jitter
            Rms without and with the feedback.

        Raises
        ------
        InputError
            The command moves, the record is too short, or its axes or unit are not the model's.

        Examples
        --------
        >>> import numpy as np
        >>> table_vibrates = 0.05 * np.sin(2 * np.pi * 5.0 * np.arange(5000) / 1000)
        >>> quiet = hc.from_arrays(0.0 * table_vibrates, table_vibrates, rate=1000, unit="um")
        >>> left = hc.tune(model, rate=1000).jitter(quiet)
        >>> float(left.closed.max() / left.without.max()) < 0.2
        True
        """
        return jitter(self, self.model, record, self.loop_delay)

    def plot(self, path: str | Path | None = None) -> list[Axes]:
        """Draw the open loop with its phase, the sensitivities and the step, and write them to a file where `path` is given."""
        return drawn(tuning_panels(self, self.model, self.loop_delay), f"{self.model.name}: PI feedback", path)


def tune(
    model: model_file.Model,
    rate: float | None = None,
    *,
    gain_margin: float = 6.0,
    phase_margin: float = 45.0,
    peak_sensitivity: float = 2.0,
    loop_delay: int = 0,
    roll_off: float | str = 0.0,
    structure: str = "pi",
    **spreads: float,
) -> Tuning:
    """Tune the PI feedback of a model to stability margins.

    Parameters
    ----------
    model
        Model of the stage.
    rate
        Sample rate of the loop, Hz; the model's by default.
    gain_margin, phase_margin, peak_sensitivity
        Least gain margin, dB, least phase margin, degrees, and greatest peak of the sensitivity.
    loop_delay
        Further delay of the loop, ticks.
    roll_off
        Corner of the feedback's roll-off, Hz; 0 for none, "auto" to choose it along with the gains.
    structure
        "pi", "pid", "notch", "damping", or "auto" for the one whose step has the least absolute error.
    **spreads
        gain_spread, mode_spread and model_error: relative spreads over which the margins hold.

    Returns
    -------
    Tuning
        Gains and what they give.

    Raises
    ------
    InputError
        No controller keeps the margins, or a parameter is out of its range.

    Examples
    --------
    >>> hc.tune(model, rate=1000, gain_margin=10).worst.gain_margin > 9.99
    True
    >>> sorted(hc.tune(model, rate=1000, structure="pid").parameters)[-2:]  # of the node pi_feedback
    ['ki', 'kp']
    """
    found = tuning.tune(
        model,
        sample_time=step_of(rate, model_of(model).sample_time),
        gain_margin=gain_margin,
        phase_margin=phase_margin,
        peak_sensitivity=peak_sensitivity,
        loop_delay=loop_delay,
        roll_off=roll_off,
        structure=structure,
        **spreads,
    )
    return promoted(Tuning, found, model=model, loop_delay=loop_delay)
