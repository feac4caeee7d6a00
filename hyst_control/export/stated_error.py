"""Error that a model states of itself (`discrepancy` in its file), tick by tick: the mean and the standard deviation, in Python and as C.

The features of `records.command_features` are those of the past but one: the rate is a difference about its tick and needs the command a
little later. The stated error is therefore late by `StatedError.late` ticks, and exact.

The zero, the drift and the curvature of a record are not part of it. They are fitted over a whole record, which no tick knows: the mean
begins at 0 where the filter has settled, and counts from there. An axis without a learned error has the mean 0 and the stated rms.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_control.chain import Filter
from hyst_control.chain.c_code import CCode, Member, integers, reals
from hyst_control.chain.parameter import Array
from hyst_control.errors import InputError
from hyst_control.identify.learned_discrepancy import LearnedDiscrepancy
from hyst_control.model_file import Model
from hyst_control.records.command_features import CREEPS, LAGS, LEAST_REVERSAL, PLAYS, CommandFeatures

POLYNOMIAL, FIRST_PLAY = 3, 15
"""Features that are powers of the level, and the place of the first play operator."""
COUNT = FIRST_PLAY + len(PLAYS) + len(LAGS) + len(CREEPS)
"""Number of features."""


@njit(cache=True, error_model="numpy")
def stated_errors(
    command: Array,
    scale: Array,
    ticks: NDArray[np.int64],
    plays: Array,
    least_reversal: float,
    mean: Array,
    factor: Array,
    rest: Array,
    position: NDArray[np.int64],
    ring: Array,
    turning: Array,
    play: Array,
    slow: Array,
    begin: Array,
    error: Array,
) -> None:
    """Follow the features over a block and state the error.

    Parameters
    ----------
    command
        (N, A), V.
    scale
        (A, 6): center and span, V, greatest rate, V/s, twice the time of the rate's difference, s, and the factors by which the two
        low-passes keep their value in a tick.
    ticks
        (A, 5): ticks that all is late, ticks of the rate's difference, ticks of the three lags.
    plays
        (P,), half widths of the play operators.
    least_reversal
        Share of the span by which a command has to come back.
    mean, factor, rest
        (A, F), (A, F, K), (A,): `LearnedDiscrepancy`.
    position
        (1,), of the newest command in the ring; changed.
    ring
        (A, L), normalized commands; changed.
    turning
        (A, 3), last turning point, farthest value since, 1 while rising; changed.
    play, slow
        (A, P), (A, 2), outputs of the play operators and low-passes; changed.
    begin
        (A, F), features where it has settled.
    error
        (N, 2 A), means, then standard deviations; filled.
    """
    axes, length = ring.shape
    count = mean.shape[1]
    features = np.empty(count)
    for row in range(command.shape[0]):
        place = position[0] + 1 if position[0] + 1 < length else 0
        position[0] = place
        for axis in range(axes):
            ring[axis, place] = (command[row, axis] - scale[axis, 0]) / scale[axis, 1]
            late, width = ticks[axis, 0], ticks[axis, 1]
            u = ring[axis, (place + length - late) % length]
            ahead, behind = (
                ring[axis, (place + length - late + width) % length],
                ring[axis, (place + length - late - width) % length],
            )
            v = (ahead - behind) / scale[axis, 3] * scale[axis, 1] / scale[axis, 2]
            speed = abs(v)
            turn, extreme, rising = turning[axis]
            if u > extreme if rising > 0.0 else u < extreme:
                extreme = u
            if abs(u - extreme) > least_reversal:  # it has come back
                turn, extreme, rising = extreme, u, 1.0 - rising
            turning[axis, 0], turning[axis, 1], turning[axis, 2] = turn, extreme, rising
            distance = u - turn
            size = abs(distance)
            features[0], features[1], features[2] = u, u * u, u * u * u
            features[3], features[4], features[5], features[6] = v, speed, u * v, u * speed
            features[7], features[8] = u * u * v, distance * speed
            features[9], features[10], features[11] = distance, size, distance * size
            features[12], features[13], features[14] = u * distance, u * size, math.tanh(20.0 * distance)
            at = 15
            for k in range(plays.size):
                low, high = u - plays[k], u + plays[k]
                state = play[axis, k]
                state = low if state < low else state
                play[axis, k] = high if state > high else state
                features[at + k] = play[axis, k]
            at += plays.size
            for k in range(3):
                features[at + k] = ring[axis, (place + length - late - ticks[axis, 2 + k]) % length] - u
            at += 3
            for k in range(2):
                keep = scale[axis, 4 + k]
                slow[axis, k] = keep * slow[axis, k] + (1.0 - keep) * u
                features[at + k] = slow[axis, k] - u
            total = 0.0
            for f in range(count):
                features[f] -= begin[axis, f]
                total += features[f] * mean[axis, f]
            square = rest[axis] * rest[axis]
            for k in range(factor.shape[2]):
                part = 0.0
                for f in range(count):
                    part += features[f] * factor[axis, f, k]
                square += part * part
            error[row, axis] = total
            error[row, axes + axis] = math.sqrt(square)


class StatedError(Filter):
    """The error that a model states of itself, beside a command: means (A) and standard deviations (A) in one row.

    Parameters
    ----------
    model
        Model with a stated error.
    sample_time
        s.

    Raises
    ------
    InputError
        It states none.
    """

    hold = "zoh"

    def __init__(self, model: Model, sample_time: float) -> None:
        if not model.discrepancy:
            raise InputError("discrepancy: the model states no error of its own: identify it with hyst identify on clean records")
        axes = len(model.axes)
        learned = [
            None if one is None else LearnedDiscrepancy.from_document(one)
            for one in model.discrepancy.get("learned", [None] * axes)
        ]
        columns = max((one.factor.shape[1] for one in learned if one), default=1)
        self.mean, self.factor = np.zeros((axes, COUNT)), np.zeros((axes, COUNT, columns))
        self.rest = np.array(np.broadcast_to(np.asarray(model.discrepancy["rms"], dtype=float), axes))
        self.scale, self.ticks = np.ones((axes, 6)), np.ones((axes, 5), dtype=np.int64)
        for axis, one in enumerate(learned):
            if one is not None:
                self.mean[axis], self.factor[axis, :, : one.factor.shape[1]] = one.mean, one.factor
                self.rest[axis] = one.rest
                self._set_scale(axis, one.features, sample_time)
        self.late = int(self.ticks[:, 1].max()) if any(learned) else 0
        """Ticks by which the stated error is late."""
        self.ticks[:, 0] = self.late
        if not any(learned):
            self.ticks[:, 1:] = 0
        length = self.late + int(self.ticks[:, 1:].max()) + 1
        self.position, self.ring = np.zeros(1, dtype=np.int64), np.zeros((axes, length))
        self.turning, self.play, self.slow = np.zeros((axes, 3)), np.zeros((axes, len(PLAYS))), np.zeros((axes, len(CREEPS)))
        self.begin = np.zeros((axes, COUNT))

    def _set_scale(self, axis: int, features: CommandFeatures, sample_time: float) -> None:
        width = max(round(0.5 * features.lag / sample_time), 1)
        keep = [np.exp(-sample_time / (share * features.duration)) for share in CREEPS]
        self.scale[axis] = features.center, features.span, features.rate, 2.0 * width * sample_time, *keep
        self.ticks[axis, 1:] = width, *(max(round(lag * features.lag / sample_time), 1) for lag in LAGS)

    def settle(self, value: Array) -> Array:
        """Come to rest at the command `value` (A,); means of 0, and the standard deviations of the rest."""
        u = (np.array(value, dtype=float) - self.scale[:, 0]) / self.scale[:, 1]
        self.position[0] = 0
        for state in (self.ring, self.play, self.slow):
            state[:] = u[:, None]
        self.turning[:] = np.stack([u, u, np.ones_like(u)], axis=1)
        self.begin[:] = 0.0
        self.begin[:, 0], self.begin[:, 1], self.begin[:, 2] = u, u * u, u * u * u
        self.begin[:, FIRST_PLAY : FIRST_PLAY + len(PLAYS)] = u[:, None]
        return np.concatenate([np.zeros_like(u), self.rest])

    def process(self, block: Array) -> Array:
        """Means and standard deviations (N, 2 A) for commands (N, A): those of the tick `late` ticks before."""
        error = np.empty((len(block), 2 * block.shape[1]))
        constants = (self.scale, self.ticks, np.array(PLAYS), LEAST_REVERSAL, self.mean, self.factor, self.rest)
        state = (self.position, self.ring, self.turning, self.play, self.slow, self.begin)
        stated_errors(block, *constants, *state, error)
        return error

    def c_code(self) -> CCode:
        constants: dict[str, Member] = {
            "scale": reals(
                self.scale, "center V, span V, rate V/s, time of its difference s, factors of the low-passes", wide=True
            ),
            "ticks": integers(self.ticks, "that all is late, of the rate, of the lags"),
            "half_widths": reals(PLAYS, "of the play operators, share of the span", wide=True),
            "mean": reals(self.mean, "of the weights, measurement unit", wide=True),
            "factor": reals(self.factor, "of the weights' covariance, measurement unit", wide=True),
            "rest": reals(self.rest, "rms of what the features leave, measurement unit", wide=True),
        }
        state = {
            "ring": reals(self.ring, "normalized commands", wide=True),
            "turning": reals(self.turning, "turning point, farthest value since, 1 while rising", wide=True),
            "play": reals(self.play, "play operators", wide=True),
            "slow": reals(self.slow, "low-passes", wide=True),
            "begin": reals(self.begin, "features where it has settled", wide=True),
            "position": integers(0, "of the newest command in the ring"),
        }
        sizes = {
            "LENGTH": self.ring.shape[1],
            "COLUMNS": self.factor.shape[2],
            "FEATURES": COUNT,
            "PLAYS": len(PLAYS),
            "LAGS": len(LAGS),
            "CREEPS": len(CREEPS),
            "POLYNOMIAL": POLYNOMIAL,
            "FIRST_PLAY": FIRST_PLAY,
        }
        step = STEP.replace("LEAST_REVERSAL", repr(LEAST_REVERSAL))
        return CCode("stated error", step, SETTLE, sizes, constants, state, outputs=2 * len(self.rest))


STEP = """
const int place = ((s->position + 1) < LENGTH) ? (s->position + 1) : 0;
s->position = place;
for (int i = 0; i < AXES; i++) {
    const double *scale = p->scale[i];
    double *ring = s->ring[i];
    double *turning = s->turning[i];
    ring[place] = ((double)in[i] - scale[0]) / scale[1];
    const int now = (place + LENGTH) - p->ticks[i][0];
    const int width = p->ticks[i][1];
    const double u = ring[now % LENGTH];
    const double v = (((ring[(now + width) % LENGTH] - ring[(now - width) % LENGTH]) / scale[3]) * scale[1]) / scale[2];
    const double speed = fabs(v);
    if (((turning[2] > 0.0) && (u > turning[1])) || ((turning[2] <= 0.0) && (u < turning[1]))) {
        turning[1] = u;
    }
    if (fabs(u - turning[1]) > LEAST_REVERSAL) { /* it has come back */
        turning[0] = turning[1];
        turning[1] = u;
        turning[2] = 1.0 - turning[2];
    }
    const double distance = u - turning[0];
    const double size = fabs(distance);
    double features[FEATURES];
    features[0] = u;
    features[1] = u * u;
    features[2] = (u * u) * u;
    features[3] = v;
    features[4] = speed;
    features[5] = u * v;
    features[6] = u * speed;
    features[7] = (u * u) * v;
    features[8] = distance * speed;
    features[9] = distance;
    features[10] = size;
    features[11] = distance * size;
    features[12] = u * distance;
    features[13] = u * size;
    features[14] = tanh(20.0 * distance);
    for (int k = 0; k < PLAYS; k++) {
        const double low = u - p->half_widths[k];
        const double high = u + p->half_widths[k];
        const double raised = (s->play[i][k] < low) ? low : s->play[i][k];
        s->play[i][k] = (raised > high) ? high : raised;
        features[FIRST_PLAY + k] = s->play[i][k];
    }
    for (int k = 0; k < LAGS; k++) {
        features[FIRST_PLAY + PLAYS + k] = ring[(now - p->ticks[i][2 + k]) % LENGTH] - u;
    }
    for (int k = 0; k < CREEPS; k++) {
        s->slow[i][k] = (scale[4 + k] * s->slow[i][k]) + ((1.0 - scale[4 + k]) * u);
        features[FIRST_PLAY + PLAYS + LAGS + k] = s->slow[i][k] - u;
    }
    double total = 0.0;
    for (int f = 0; f < FEATURES; f++) {
        features[f] -= s->begin[i][f];
        total += features[f] * p->mean[i][f];
    }
    double square = p->rest[i] * p->rest[i];
    for (int k = 0; k < COLUMNS; k++) {
        double part = 0.0;
        for (int f = 0; f < FEATURES; f++) {
            part += features[f] * p->factor[i][f][k];
        }
        square += part * part;
    }
    out[i] = (real)total;
    out[AXES + i] = (real)sqrt(square);
}
"""
"""`stated_errors` in C, in double also where signals are float."""

SETTLE = """
s->position = 0;
for (int i = 0; i < AXES; i++) {
    const double u = ((double)in[i] - p->scale[i][0]) / p->scale[i][1];
    for (int k = 0; k < LENGTH; k++) {
        s->ring[i][k] = u;
    }
    for (int k = 0; k < CREEPS; k++) {
        s->slow[i][k] = u;
    }
    s->turning[i][0] = u;
    s->turning[i][1] = u;
    s->turning[i][2] = 1.0;
    for (int f = 0; f < FEATURES; f++) {
        s->begin[i][f] = 0.0;
    }
    double power = u;
    for (int f = 0; f < POLYNOMIAL; f++) {
        s->begin[i][f] = power;
        power = power * u;
    }
    for (int k = 0; k < PLAYS; k++) {
        s->play[i][k] = u;
        s->begin[i][FIRST_PLAY + k] = u;
    }
    out[i] = R(0.0);
    out[AXES + i] = (real)p->rest[i];
}
"""
"""`StatedError.settle` in C."""
