# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modes behind a delay, all found at once by vector fitting: none of a mode and a long delay is found without the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.identify.modal.vector_fitting import Partial, spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.pole_zero_pair import with_numerator
from hyst_control.identify.solve.stable_dynamics import TAU_UNIT, Structure

MOST_MODES = 2  # Largest number of modes
DELAYS = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 24.0, 32.0)
"""Delays (samples) at which modes are looked for."""


def late_modes(parts: Sequence[Window], like: Structure) -> list[tuple[Structure, Array]]:
    """Structures and dynamics vectors of one and of two modes behind a delay, in the pace of `like`.

    parts: windows of one sample time, with the output of the hysteresis in place of the command. The steps from row to row are fitted, in
    which slow loops hide no mode.
    """
    from scipy.signal import invres  # takes a second

    sample_time = parts[0].sample_time
    parts = [
        replace(each, command=np.diff(each.command), measurement=np.diff(each.measurement), skip=max(each.skip - 1, 0))
        for each in parts
    ]
    rows = [len(part.command) for part in parts]
    delays = [delay for delay in DELAYS if delay <= min(rows) / 8]
    found: list[tuple[Structure, Array]] = []

    def fits(count: int, delays: Sequence[float]) -> list[Partial]:
        start = spread_poles(2 * count, max(rows))
        return list(map_forked(lambda index: vector_fit(parts, start, delays[index], False, relocations=4), len(delays)))

    for count in range(1, MOST_MODES + 1):
        tried = fits(count, delays)
        nearest = int(np.argmin([each.error for each in tried]))
        pairs = tried[nearest].poles.imag > 0
        poles, residues = (values[pairs] / sample_time for values in (tried[nearest].poles, tried[nearest].residues))
        if len(poles):
            structure = replace(like, modes=len(poles), lags=0, zeros=2 * len(poles) - 2, slow_pair=False, delay=True)
            parts_of = structure.split(structure.start(1.0))
            parts_of["modes"][:] = np.log(np.column_stack([np.abs(poles), -poles.real / np.abs(poles)]))
            parts_of["delay"][:] = delays[nearest] * sample_time / (TAU_UNIT * structure.pace)
            num = invres(np.append(residues, residues.conj()), np.append(poles, poles.conj()), [])[0].real
            found.append((structure, with_numerator(parts_of, num[-1 - structure.zeros :])))
        delays = delays[max(nearest - 2, 0) : nearest + 3]
    return found
