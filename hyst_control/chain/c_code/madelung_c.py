# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""C of the kernels of `madelung`, line for line."""

from __future__ import annotations

CAPACITY = 48
"""Turning points that the C of an axis keeps beside those of rest, which are constants. Up to there it is the Python filter to the last
bit; where more are nested, it forgets the loop whose end comes closest to its begin, and counts that in `forgotten`: then the loops
outside the forgotten one are still exact, and those inside it close where it would have. The Python filter keeps all."""


FORGET = """
/* Forget the loop whose end comes closest to its begin; the number of turning points that are left. */
static int without_flattest_loop(real stack[][2], int depth)
{
    int flattest = 1;
    real least = R(2.0);
    for (int i = 1; i < (depth - 2); i++) {
        const real gap = M(fabs)(stack[i][0] - stack[i + 2][0]);
        if (gap < least) {
            least = gap;
            flattest = i;
        }
    }
    for (int i = flattest + 1; i < (depth - 2); i++) {
        stack[i][0] = stack[i + 2][0];
        stack[i][1] = stack[i + 2][1];
    }
    return depth - 2;
}
"""


TURNING_POINT = "((({0}) < kept) ? p->rest_stack[axis][{0}] : s->stack[axis][({0}) - kept])"
"""A turning point by its place from the bottom: one of rest, or one since."""


STEP = """
for (int axis = 0; axis < AXES; axis++) {
    const curve rising = {p->rising_breaks[axis], p->rising[axis][0], p->rising_size[axis][0], p->rising_size[axis][1]};
    const curve falling = {p->falling_breaks[axis], p->falling[axis][0], p->falling_size[axis][0], p->falling_size[axis][1]};
    const real full = p->full[axis];
    const real top = (INVERSE != 0) ? full : R(1.0);
    const real raw = ((INVERSE != 0) ? in[axis] : (in[axis] - p->offset[axis])) * p->to_inside[axis];
    const real x = (raw < R(0.0)) ? R(0.0) : ((raw > top) ? top : raw);
    real u = s->last[axis][0];
    real y = s->last[axis][1];
    const real before = (INVERSE != 0) ? y : u;
    if ((x != before) && !isnan(x)) {
        const real onward = (x > before) ? R(1.0) : R(-1.0);
        int depth = s->depth[axis];
        int kept = s->kept[axis];
        if (onward != s->last[axis][2]) {
            if (@TOP 1@[KEY] != before) {
                if ((depth - kept) == CAPACITY) {
                    depth = kept + without_flattest_loop(s->stack[axis], CAPACITY);
                    s->forgotten[axis] = (s->forgotten[axis] < 1000000000) ? (s->forgotten[axis] + 1) : s->forgotten[axis];
                }
                s->stack[axis][depth - kept][0] = u;
                s->stack[axis][depth - kept][1] = y;
                depth++;
            }
            s->last[axis][2] = onward;
            s->moved[axis] = 1;
        }
        if ((x >= top) || (x <= R(0.0))) {
            u = (x > R(0.0)) ? R(1.0) : R(0.0);
            y = (x > R(0.0)) ? full : R(0.0);
            s->stack[axis][0][0] = R(1.0) - u;
            s->stack[axis][0][1] = full - y;
            s->stack[axis][1][0] = u;
            s->stack[axis][1][1] = y;
            depth = 2;
            kept = 0;
            s->moved[axis] = 1;
        } else {
            while ((depth > 2) && ((onward * (x - @TOP 2@[KEY])) >= R(0.0))) {
                depth -= 2;
                kept = (kept < depth) ? kept : depth;
                s->moved[axis] = 1;
            }
            if (s->moved[axis] != 0) {
                const real *begin = @TOP 1@;
                const real *end = @TOP 2@;
                const real u_from = begin[0];
                const real y_from = begin[1];
                const real u_to = end[0];
                const real y_to = end[1];
                const real whole = (onward > R(0.0)) ? curve_value(rising, u_to - u_from) : curve_value(falling, u_from - u_to);
                s->branch[axis][0] = u_from;
                s->branch[axis][1] = y_from;
                s->branch[axis][2] = (y_to - y_from) / whole;
                s->moved[axis] = 0;
            }
            const real *from = s->branch[axis];
            FOLLOW
        }
        s->depth[axis] = depth;
        s->kept[axis] = kept;
    }
    real value = (INVERSE != 0) ? u : y;
    if (raw != x) {
        const real slope = (raw > x) ? p->end_slope[axis][1] : p->end_slope[axis][0];
        value += (INVERSE != 0) ? ((raw - x) / slope) : ((raw - x) * slope);
    }
    s->last[axis][0] = u;
    s->last[axis][1] = y;
    out[axis] = (INVERSE != 0) ? ((value * p->to_outside[axis]) + p->offset[axis]) : (value * p->to_outside[axis]);
}
""".replace("@TOP 1@", TURNING_POINT.format("depth - 1")).replace("@TOP 2@", TURNING_POINT.format("depth - 2"))
"""`madelung_branches` in C."""


FORWARD = """
y = from[1] + (from[2] * ((onward > R(0.0)) ? curve_value(rising, x - from[0]) : curve_value(falling, from[0] - x)));
u = x;
"""


BACKWARD = """
const real way = (x - from[1]) / from[2];
u = (onward > R(0.0)) ? (from[0] + curve_argument(rising, way)) : (from[0] - curve_argument(falling, way));
y = x;
"""


MEAN = """
for (int axis = 0; axis < AXES; axis++) {
    const curve up = {p->up_breaks[axis], p->up[axis][0], p->up_size[axis][0], p->up_size[axis][1]};
    const curve down = {p->down_breaks[axis], p->down[axis][0], p->down_size[axis][0], p->down_size[axis][1]};
    const real x = (in[axis] - p->lower[axis]) / p->span[axis];
    const real inside = minimum_of(maximum_of(x, R(0.0)), R(1.0));
    const real beyond = ((x > R(1.0)) ? p->end_slope[axis][1] : p->end_slope[axis][0]) * (x - inside);
    out[axis] = p->scale[axis] * ((R(0.5) * (curve_value(up, inside) + curve_value(down, inside))) + beyond);
}
"""
"""`Madelung.mean_curve` in C."""


SETTLE = """
for (int axis = 0; axis < AXES; axis++) {
    s->depth[axis] = p->rest_depth[axis];
    s->kept[axis] = p->rest_depth[axis];
    for (int i = 0; i < 3; i++) {
        s->last[axis][i] = p->rest_last[axis][i];
    }
    s->moved[axis] = 1;
    s->forgotten[axis] = 0;
}
SELF_step(s, in, out);
"""
"""`MadelungFilter.settle` in C."""
