# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The watch over the sensors in C: see `export.controller` for the whole.

The order of every expression is that of `control.sensor_watch`, so that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hyst_control.chain.c_code.c_code import Member, integers, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.control.feedback.sensor_watch import AGAINST, ALIVE, FORGOTTEN, JUMP, STILL, MeasurementWatch, smoothing_share

C = c_texts(__file__, FORGOTTEN=FORGOTTEN, STILL=STILL, ALIVE=ALIVE)
RANGES, SETTLE, WATCH = (C[name] for name in ("RANGES", "SETTLE", "WATCH"))


def constants(watch: MeasurementWatch) -> Mapping[str, Member]:
    """Constants of the watch."""
    return {
        "measurement_lower": reals(watch.lower, "measurement unit"),
        "measurement_upper": reals(watch.upper, "measurement unit"),
        "span": reals(watch.upper - watch.lower, "measurement unit, greatest error that counts"),
        "motion": reals(watch.motion, "V, that ask for an answer of the measurement"),
        "jump_motion": reals(JUMP * watch.motion, "V, of which the answer within a tick is a jump"),
        "against_motion": reals(AGAINST * watch.motion, "V, against which the measurement has gone when its sign has turned"),
        "smoothing": reals(smoothing_share(watch.frozen_ticks), "share of a step that the watch's low-passes let pass"),
    }


def state(axes: int) -> Mapping[str, Member]:
    """State of the watch."""
    zeros, unknown = np.zeros(axes), np.full(axes, np.nan)
    return {
        "error": reals(zeros, "mean error"),
        "watched": reals(unknown, "around which the measurement stays; NaN before the first"),
        "flicker": reals(zeros, "largest distance from it"),
        "least": reals(zeros, "V, command meanwhile"),
        "most": reals(zeros, "V, command meanwhile"),
        "same": integers(zeros, "ticks without an answer since the command has moved"),
        "waited": integers(zeros, "ticks before it has"),
        "gain": reals(zeros, "learned, measurement unit per V; 0 before it is"),
        "volts_range": reals(np.full((2, axes), np.nan), "V, least and most of the command through the low-pass"),
        "smooth_range": reals(np.full((2, axes), np.nan), "least and most of the measurement through the low-pass"),
        "newest": reals(unknown, "measurement of the tick before"),
        "smooth": reals(unknown, "measurement through the low-pass"),
        "smooth_before": reals(unknown, "where the movement of the command began"),
        "volts": reals(unknown, "V, command through the low-pass"),
        "volts_before": reals(unknown, "V, where its movement began"),
        "moving": integers(zeros, "ticks since it began"),
        "against": reals(zeros, "V, against which the measurement has gone"),
    }
