"""The watch over the sensors in C: see `export.controller` for the whole.

The order of every expression is that of `control.sensor_watch`, so that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hyst_control.chain.c_code import Member, integers, reals
from hyst_control.control.sensor_watch import AGAINST, JUMP, STEP, STILL, MeasurementWatch, smoothing_share


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
        "least": reals(zeros, "V, command meanwhile"),
        "most": reals(zeros, "V, command meanwhile"),
        "same": integers(zeros, "ticks without an answer since the command has moved"),
        "waited": integers(zeros, "ticks before it has"),
        "gain": reals(zeros, "learned, measurement unit per V; 0 before it is"),
        "newest": reals(unknown, "measurement of the tick before"),
        "smooth": reals(unknown, "measurement through the low-pass"),
        "smooth_before": reals(unknown, "where the movement of the command began"),
        "volts": reals(unknown, "V, command through the low-pass"),
        "volts_before": reals(unknown, "V, where its movement began"),
        "moving": integers(zeros, "ticks since it began"),
        "against": reals(zeros, "V, against which the measurement has gone"),
    }


SETTLE = """
for (int i = 0; i < AXES; i++) {
    s->error[i] = R(0.0);
    s->watched[i] = (real)NAN;
    s->least[i] = R(0.0);
    s->most[i] = R(0.0);
    s->same[i] = 0;
    s->waited[i] = 0;
    s->gain[i] = R(0.0);
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
    const real error = M(fabs)(reference[i] - measurement[i]);
    s->error[i] = s->error[i] + (p->smoothing * (((error < p->span) ? error : p->span) - s->error[i]));
    /* Does the measurement answer the command? */
    if (!(M(fabs)(measurement[i] - s->watched[i]) <= (R({STILL!r}) * s->error[i]))) {{
        s->watched[i] = measurement[i];
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
        s->against[i] = R(0.0);
    }}
    s->newest[i] = measurement[i];
    s->volts[i] = s->volts[i] + (p->smoothing * (last[i] - s->volts[i]));
    s->smooth[i] = s->smooth[i] + (p->smoothing * (measurement[i] - s->smooth[i]));
    s->moving[i] = s->moving[i] + 1;
    const real enough = p->against_motion * ((s->gain[i] == R(0.0)) ? R(3.0) : R(1.0));
    const real moved = s->volts[i] - s->volts_before[i];
    if (M(fabs)(moved) >= p->motion) {{
        const real ratio = (s->smooth[i] - s->smooth_before[i]) / moved;
        const real gain = s->gain[i];
        const int like = ((gain == R(0.0)) || (((R(0.5) * gain) <= -ratio) && (-ratio <= (R(2.0) * gain)))) ? 1 : 0;
        if ((ratio >= R(0.0)) || (like == 0)) {{
            s->against[i] = R(0.0);
        }} else if (M(fabs)(s->against[i]) < enough) {{
            s->against[i] = moved + (((s->against[i] * moved) > R(0.0)) ? s->against[i] : R(0.0));
        }} else {{
            /* it has turned, until the measurement moves with the command again */
        }}
        if (ratio > R(0.0)) {{
            s->gain[i] = (gain == R(0.0)) ? ratio : ((ratio > gain) ? (gain * R({STEP!r})) : (gain / R({STEP!r})));
        }}
    }} else if (s->moving[i] >= FROZEN) {{
        s->against[i] = (M(fabs)(s->against[i]) < enough) ? R(0.0) : s->against[i];
    }} else {{
        /* the movement goes on */
    }}
    if ((M(fabs)(moved) >= p->motion) || (s->moving[i] >= FROZEN)) {{
        s->volts_before[i] = s->volts[i];
        s->smooth_before[i] = s->smooth[i];
        s->moving[i] = 0;
    }}
    watched = (s->same[i] >= FROZEN) ? 4 : ((M(fabs)(s->against[i]) >= enough) ? 6 : 0);
}} else {{
    /* it is not watched */
}}
"""
"""`MeasurementWatch.check` in C for axis i, of the arrays reference, measurement and last; `watched` is the fault's code."""
