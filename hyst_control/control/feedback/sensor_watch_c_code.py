# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The watch over the sensors in C: see `export.controller` for the whole.

The order of every expression is that of `control.sensor_watch`, so that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hyst_control.chain.c_code.c_code import Member, integers, reals
from hyst_control.control.feedback.sensor_watch import AGAINST, ALIVE, FORGOTTEN, JUMP, STILL, MeasurementWatch, smoothing_share


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


RANGES = f"""
/* Ends of a range with a further value, which forget old ones. */
static real forgotten_least(real least, real value)
{{
    const real near = least + (R({FORGOTTEN!r}) * (value - least));
    return (near < value) ? near : value;
}}

static real forgotten_most(real most, real value)
{{
    const real near = most + (R({FORGOTTEN!r}) * (value - most));
    return (near > value) ? near : value;
}}
"""

SETTLE = """
for (int i = 0; i < AXES; i++) {
    s->error[i] = R(0.0);
    s->watched[i] = (real)NAN;
    s->flicker[i] = R(0.0);
    s->least[i] = R(0.0);
    s->most[i] = R(0.0);
    s->same[i] = 0;
    s->waited[i] = 0;
    s->gain[i] = R(0.0);
    for (int k = 0; k < 2; k++) {
        s->volts_range[k][i] = (real)NAN;
        s->smooth_range[k][i] = (real)NAN;
    }
    s->newest[i] = (real)NAN;
    s->smooth[i] = (real)NAN;
    s->smooth_before[i] = (real)NAN;
    s->volts[i] = (real)NAN;
    s->volts_before[i] = (real)NAN;
    s->moving[i] = 0;
    s->against[i] = R(0.0);
}
"""

WATCH = f"""
int watched = 0;
if ((measurement[i] < p->measurement_lower) || (measurement[i] > p->measurement_upper)) {{
    watched = 3;
}} else if (FROZEN > 0) {{
    if (s->same[i] < FROZEN) {{
        const real away = M(fabs)(((s->away[i] != 0) ? measurement[i] : reference[i]) - measurement[i]);
        const real reach = s->gain[i] * (p->upper - p->lower);
        const real span = ((R(0.0) < reach) && (reach < p->span)) ? reach : p->span;
        const real error = ((p->lower < last[i]) && (last[i] < p->upper)) ? ((away < span) ? away : span) : R(0.0);
        s->error[i] = s->error[i] + (p->smoothing * (error - s->error[i]));
    }}
    /* Does the measurement answer the command? */
    const real moved_by = M(fabs)(measurement[i] - s->watched[i]);
    real still = R({STILL!r}) * s->error[i];
    if (s->same[i] < FROZEN) {{
        s->flicker[i] = ((s->flicker[i] < moved_by) && (moved_by <= still)) ? moved_by : s->flicker[i];
    }} else {{
        const real alive = R({ALIVE!r}) * s->flicker[i];
        still = (alive < still) ? alive : still;
    }}
    if (!(moved_by <= still)) {{
        s->watched[i] = measurement[i];
        s->flicker[i] = R(0.0);
        s->same[i] = 0;
        s->waited[i] = 0;
        s->least[i] = last[i];
        s->most[i] = last[i];
    }} else {{
        s->least[i] = (last[i] < s->least[i]) ? last[i] : s->least[i];
        s->most[i] = (last[i] > s->most[i]) ? last[i] : s->most[i];
        if ((s->most[i] - s->least[i]) > p->motion) {{
            s->same[i] = (s->same[i] < FROZEN) ? (s->same[i] + 1) : s->same[i];
        }} else {{
            s->waited[i] = s->waited[i] + 1;
            if (s->waited[i] > SLOW) {{
                s->waited[i] = 0;
                s->least[i] = last[i];
                s->most[i] = last[i];
            }}
        }}
    }}
    /* Has its sign turned? */
    const real allowed = s->gain[i] * (p->jump_motion + (R(3.0) * M(fabs)(last[i] - s->volts[i])));
    if (isnan(s->newest[i]) || ((s->gain[i] > R(0.0)) && (M(fabs)(measurement[i] - s->newest[i]) > allowed))) {{
        s->smooth[i] = measurement[i];
        s->smooth_before[i] = measurement[i];
        s->volts[i] = last[i];
        s->volts_before[i] = last[i];
        s->moving[i] = 0;
        for (int k = 0; k < 2; k++) {{
            s->volts_range[k][i] = last[i];
            s->smooth_range[k][i] = measurement[i];
        }}
        s->against[i] = R(0.0);
    }}
    s->newest[i] = measurement[i];
    s->volts[i] = s->volts[i] + (p->smoothing * (last[i] - s->volts[i]));
    s->smooth[i] = s->smooth[i] + (p->smoothing * (measurement[i] - s->smooth[i]));
    s->moving[i] = s->moving[i] + 1;
    const real moved = s->volts[i] - s->volts_before[i];
    const int far = (M(fabs)(moved) >= p->motion) ? 1 : 0;
    if (far != 0) {{
        const real answer = -(s->smooth[i] - s->smooth_before[i]) / moved;
        const real gain = s->gain[i];
        if (!(((R(0.5) * gain) <= answer) && (answer <= (R(2.0) * gain))) || (gain == R(0.0))) {{
            s->against[i] = R(0.0);
        }} else if (M(fabs)(s->against[i]) < p->against_motion) {{
            s->against[i] = moved + (((s->against[i] * moved) > R(0.0)) ? s->against[i] : R(0.0));
        }} else {{
            /* it has turned, until the measurement moves with the command again */
        }}
    }} else if ((s->moving[i] >= FROZEN) && (M(fabs)(s->against[i]) < p->against_motion)) {{
        s->against[i] = R(0.0);
    }} else {{
        /* the movement goes on */
    }}
    if ((far != 0) || (s->moving[i] >= FROZEN)) {{
        s->volts_before[i] = s->volts[i];
        s->smooth_before[i] = s->smooth[i];
        s->moving[i] = 0;
        s->volts_range[0][i] = forgotten_least(s->volts_range[0][i], s->volts[i]);
        s->volts_range[1][i] = forgotten_most(s->volts_range[1][i], s->volts[i]);
        s->smooth_range[0][i] = forgotten_least(s->smooth_range[0][i], s->smooth[i]);
        s->smooth_range[1][i] = forgotten_most(s->smooth_range[1][i], s->smooth[i]);
        const real covered = s->volts_range[1][i] - s->volts_range[0][i];
        if (covered >= p->against_motion) {{
            s->gain[i] = (s->smooth_range[1][i] - s->smooth_range[0][i]) / covered;
        }}
    }}
    watched = (s->same[i] >= FROZEN) ? 4 : ((M(fabs)(s->against[i]) >= p->against_motion) ? 6 : 0);
}} else {{
    /* it is not watched */
}}
"""
"""`MeasurementWatch.check` in C for axis i, of the arrays reference, measurement and last; `watched` is the fault's code."""
