# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear models of the measured mirror: fitted by level, their error, and the models that lose one element."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from evaluation.reproduction import fsm_cubespec_records as mirror
from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import Delay, StateSpace
from hyst_control.chain.stage import frozen
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.model_error.learned_discrepancy import discrepancy_of
from hyst_control.model_file import Model

ORDER = 46
"""States of the mirror's linear models."""
DELAYS = (0.0, 0.25, 0.5, 0.75)
"""Candidates in samples; the fifth realization chooses among them."""
LOST_GAIN = 0.05
MIN_SHARE = 1.0
"""Energy of a deleted mode, relative to the residual of the whole model, above which its loss is diagnosed."""
HIGHEST_MODE = 3000.0
"""Hz, below which modes are deleted: the excitation ends at 3200 Hz."""


def rms_error(model: Model, level: mirror.Level, realization: int) -> float:
    """Rms error of a model on a realization, both periods and all axes."""
    return float(np.sqrt(np.mean(np.square(residuals(model, level, realization)))))


def residuals(model: Model, level: mirror.Level, realization: int) -> list[Array]:
    """Compute measured minus simulated of a realization, in the steady state."""
    simulated = mirror.steady_state(model, level.command[:, :, [realization]].mean(axis=3))[:, :, 0]
    return list((level.measurement[:, :, realization] - simulated[..., None]).transpose(2, 0, 1))


def stated_model(found: Candidate, level: mirror.Level, realization: int, name: str) -> Model:
    """Convert a fit to a model that states its error on a realization that it was not fitted on, as `hyst identify` does."""
    model = mirror.model_of(found.model, name, level.largest)
    commands, measurements = (list(rows[:, :, realization].transpose(2, 0, 1)) for rows in (level.command, level.measurement))
    own = discrepancy_of(commands, residuals(model, level, realization), mirror.SAMPLE_TIME, measurements)
    return replace(model, discrepancy=own)


def models_without_elements(model: Model, level: mirror.Level, floor: float) -> Iterator[tuple[str, tuple[str, ...], Model]]:
    """Remove one element of a model after the other."""
    *before, whole = model.chain.stages
    assert isinstance(whole, StateSpace)
    if any(isinstance(stage, Delay) for stage in before):
        yield "input delay", ("delay", "sensor_lowpass", "amplifier_lowpass", "dac_hold"), model.with_stages([whole])
    yield "coupling", ("cross_coupling",), model.with_stages([*before, uncoupled(whole)])
    weaker = replace(whole, **{part: frozen((1.0 - LOST_GAIN) * np.array(getattr(whole, part))) for part in "CD"})
    yield f"{100 * LOST_GAIN:g} % of its gain", ("gain", "hysteresis_width"), model.with_stages([*before, weaker])
    command = level.command[:, :, [mirror.TEST[0]]].mean(axis=3)
    simulated = mirror.steady_state(model, command)
    for block, frequency in oscillating(whole):
        crippled = model.with_stages([*before, without_states(whole, block)])
        lost = mirror.steady_state(crippled, command) - simulated
        if np.mean(lost**2) > MIN_SHARE * floor**2:
            yield f"mode at {frequency:.0f} Hz", ("resonance",), crippled


def uncoupled(whole: StateSpace) -> StateSpace:
    """Remove the coupling: every axis is driven by its own input alone."""
    a, b, c, d = (np.array(getattr(whole, part), dtype=float) for part in "ABCD")
    axes = range(len(d))
    return StateSpace(
        frozen(block_diag(*(a for _ in axes))),
        frozen(block_diag(*(b[:, [i]] for i in axes))),
        frozen(block_diag(*(c[[i]] for i in axes))),
        frozen(np.diag(np.diag(d))),
    )


def oscillating(whole: StateSpace) -> Iterator[tuple[slice, float]]:
    """Find the oscillating modes of a block-diagonal system below the band's end."""
    a = np.array(whole.A, dtype=float)
    row = 0
    while row < len(a):
        size = 2 if row + 1 < len(a) and a[row, row + 1] else 1
        if size == 2:
            frequency = float(np.abs(np.linalg.eigvals(a[row : row + 2, row : row + 2])[0])) / (2 * np.pi)
            if frequency < HIGHEST_MODE:
                yield slice(row, row + 2), frequency
        row += size


def without_states(whole: StateSpace, block: slice) -> StateSpace:
    """Remove some states of a system."""
    a, b, c = (np.array(getattr(whole, part), dtype=float) for part in "ABC")
    gone = np.arange(block.start, block.stop)
    kept = np.delete(np.delete(a, gone, axis=0), gone, axis=1)
    return replace(whole, A=frozen(kept), B=frozen(np.delete(b, gone, axis=0)), C=frozen(np.delete(c, gone, axis=1)))
