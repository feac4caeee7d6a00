# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""C of the kernels of `softening_modal`, line for line."""

from __future__ import annotations

MODES = """
/* A complex number of a pair. */
static complex_number complex_at(const real pair[])
{
    return complex_of(pair[0], pair[1]);
}

/* What all modes' poles depend on. */
static real modes_amplitude(real a, real amplitude, real span)
{
    return (M(sqrt)(a / amplitude) - R(1.0)) / span;
}
"""

POLE = """
        const int oscillates = (p->frequency[i] != R(0.0)) ? 1 : 0;
        const complex_number pole = complex_of(
            -M(exp)(p->decay[i] + (p->decay_change[i] * g)),
            (oscillates != 0) ? (p->frequency[i] + (p->frequency_change[i] * g)) : R(0.0));
        const real twice = (oscillates != 0) ? R(2.0) : R(1.0);
"""

STOPS = """
for (int e = 0; e < THRESHOLDS; e++) {{
    for (int j = 0; j < AXES; j++) {{
        const int at = (e * AXES) + j;
        const real low = {command}[j] - p->threshold[e];
        const real high = {command}[j] + p->threshold[e];
        const real above = ({play} > low) ? {play} : low;
        s->play[at] = (above < high) ? above : high;
        s->force[(EXPONENTS * AXES) + at] = ({command}[j] - s->play[at]) - (p->stop_mean[at] * {command}[j]);
    }}
}}
"""
"""Stop operators of the command, from the play that they had."""

FORCE = """
real strain[AXES];
int product = 0;
for (int j = 0; j < AXES; j++) {
    real q = R(0.0);
    for (int o = 0; o < AXES; o++) {
        q += p->k[j][o] * linear[o];
    }
    for (int e = 0; e < EXPONENTS; e++) {
        const int at = (e * AXES) + j;
        s->force[at] = q * (M(pow)(M(fabs)(q), p->exponent[e]) - (p->force_mean[at] * M(pow)(a, p->exponent[e])));
    }
    strain[j] = q;
}
for (int j = 0; j < AXES; j++) {
    for (int e = j; e < AXES; e++) {
        s->force[((EXPONENTS + THRESHOLDS) * AXES) + product] = (strain[j] * strain[e]) - ((p->product_mean[product] * a) * a);
        product++;
    }
}
"""

ADVANCE = (
    """
real drive[AXES];
real linear[AXES];
real power = R(0.0);
for (int j = 0; j < AXES; j++) {
    drive[j] = (HELD != 0) ? in[j] : (R(0.5) * (in[j] + s->last[j]));
    power += drive[j] * drive[j];
    s->last[j] = in[j];
}
s->mean_square += p->smooth * ((power / (real)AXES) - s->mean_square);
const real a = M(sqrt)(s->mean_square);
const real g = modes_amplitude(a, p->amplitude, p->span);
"""
    + STOPS.format(command="drive", play="s->play[at]")
    + """
for (int o = 0; o < AXES; o++) {
    linear[o] = R(0.0);
    out[o] = R(0.0);
    for (int j = 0; j < AXES; j++) {
        linear[o] += p->d[o][j] * drive[j];
    }
    for (int j = 0; j < FORCES; j++) {
        out[o] += p->h_d[o][j] * s->force[j];
    }
}
for (int i = 0; i < MODES; i++) {"""
    + POLE
    + """
    const complex_number carry = complex_exp(complex_of(pole.re * p->time, pole.im * p->time));
    const complex_number gain = complex_over(complex_minus(carry, complex_of(R(1.0), R(0.0))), pole);
    complex_number by_command = complex_of(R(0.0), R(0.0));
    complex_number by_force = complex_of(R(0.0), R(0.0));
    for (int j = 0; j < AXES; j++) {
        const complex_number moved = complex_times(complex_at(p->b_change[i][j]), complex_of(g, R(0.0)));
        const complex_number entering = complex_plus(complex_at(p->b[i][j]), moved);
        by_command = complex_plus(by_command, complex_times(entering, complex_of(drive[j], R(0.0))));
    }
    for (int j = 0; j < FORCES; j++) {
        by_force = complex_plus(by_force, complex_times(complex_at(p->h[i][j]), complex_of(s->force[j], R(0.0))));
    }
    const complex_number x = complex_plus(complex_times(carry, complex_at(s->x[0][i])), complex_times(gain, by_command));
    const complex_number w = complex_plus(complex_times(carry, complex_at(s->x[1][i])), complex_times(gain, by_force));
    s->x[0][i][0] = x.re;
    s->x[0][i][1] = x.im;
    s->x[1][i][0] = w.re;
    s->x[1][i][1] = w.im;
    for (int o = 0; o < AXES; o++) {
        linear[o] += twice * complex_times(complex_at(p->c[i][o]), x).re;
        out[o] += twice * complex_times(complex_at(p->c[i][o]), w).re;
    }
}
for (int o = 0; o < AXES; o++) {
    out[o] += linear[o];
}
"""
    + FORCE
)
"""`advance_softening_modal` in C."""

COME_TO_REST = (
    """
real linear[AXES];
real power = R(0.0);
for (int j = 0; j < AXES; j++) {
    power += in[j] * in[j];
    s->last[j] = in[j];
}
s->mean_square = power / (real)AXES;
const real a = M(sqrt)(s->mean_square);
const real g = modes_amplitude(a, p->amplitude, p->span);
"""
    + STOPS.format(command="in", play="R(0.0)")
    + """
for (int o = 0; o < AXES; o++) {
    linear[o] = R(0.0);
    for (int j = 0; j < AXES; j++) {
        linear[o] += p->d[o][j] * in[j];
    }
}
for (int i = 0; i < MODES; i++) {"""
    + POLE
    + """
    complex_number entering = complex_of(R(0.0), R(0.0));
    for (int j = 0; j < AXES; j++) {
        const complex_number moved = complex_times(complex_at(p->b_change[i][j]), complex_of(g, R(0.0)));
        const complex_number both = complex_plus(complex_at(p->b[i][j]), moved);
        entering = complex_plus(entering, complex_times(both, complex_of(in[j], R(0.0))));
    }
    const complex_number x = complex_over(complex_of(-entering.re, -entering.im), pole);
    s->x[0][i][0] = x.re;
    s->x[0][i][1] = x.im;
    for (int o = 0; o < AXES; o++) {
        linear[o] += twice * complex_times(complex_at(p->c[i][o]), x).re;
    }
}
"""
    + FORCE
    + """
for (int o = 0; o < AXES; o++) {
    out[o] = linear[o];
    for (int j = 0; j < FORCES; j++) {
        out[o] += p->h_d[o][j] * s->force[j];
    }
}
for (int i = 0; i < MODES; i++) {"""
    + POLE
    + """
    complex_number entering = complex_of(R(0.0), R(0.0));
    for (int j = 0; j < FORCES; j++) {
        entering = complex_plus(entering, complex_times(complex_at(p->h[i][j]), complex_of(s->force[j], R(0.0))));
    }
    const complex_number w = complex_over(complex_of(-entering.re, -entering.im), pole);
    s->x[1][i][0] = w.re;
    s->x[1][i][1] = w.im;
    for (int o = 0; o < AXES; o++) {
        out[o] += twice * complex_times(complex_at(p->c[i][o]), w).re;
    }
}
"""
)
"""`settle_softening_modal` in C."""
