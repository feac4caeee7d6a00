/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* The chain's inner loops in C, for `hyst bench` to time beside the compiled Python ones: same algorithm, same memory layout. */

#include <math.h>

void dynamic_prandtl_ishlinskii(long rows, long axes, long count, const double *command, double *previous, double rate_factor,
                                const double *thresholds, const double *release, const double *weights, const double *w0,
                                const double *m1, const double *m2, const double *k, const double *b, double *state,
                                double *output)
{
    for (long row = 0; row < rows; row++) {
        for (long axis = 0; axis < axes; axis++) {
            double u = command[row * axes + axis], total = 0.0, weighted = 0.0;
            for (long i = 0; i < count; i++) {
                double low = u - thresholds[axis * count + i];
                double high = u + release[axis * count + i];
                double h = state[axis * count + i];
                h = h > high ? high : h;
                h = h < low ? low : h;
                state[axis * count + i] = h;
                total += h;
                weighted += weights[axis * count + i] * h;
            }
            double rate = (u - previous[axis]) * rate_factor;
            previous[axis] = u;
            double rotation = rate >= 0.0 ? -m1[axis] * rate : m2[axis] * rate;
            output[row * axes + axis] = w0[axis] * u + weighted + (rotation + k[axis] * u + b[axis]) * total;
        }
    }
}

long advance_single(long rows, long systems, long n, long length, const double *restrict block, const double *restrict a,
                    const double *restrict b, const double *restrict c, const double *restrict d, const double *restrict bias,
                    const long *restrict whole, double *restrict state, double *restrict scratch, double *restrict history,
                    long position, double *restrict output)
{
    const double tiny = 1e-80;
    long begin = position;
    for (long s = 0; s < systems; s++) {
        const double *matrix = a + s * n * n, *newest_b = b + s * 3 * n, *middle_b = newest_b + n, *oldest_b = middle_b + n;
        const double *gain = c + s * n;
        double *x = state + s * n;
        position = begin;
        for (long row = 0; row < rows; row++) {
            history[position * systems + s] = block[row * systems + s];
            long first = position - whole[s];
            first = first < 0 ? first + length : first;
            long second = first > 0 ? first - 1 : length - 1;
            long third = second > 0 ? second - 1 : length - 1;
            double newest = history[first * systems + s], middle = history[second * systems + s];
            double oldest = history[third * systems + s];
            for (long i = 0; i < n; i++) {
                double value = 0.0;
                for (long j = 0; j < n; j++)
                    value += matrix[i * n + j] * x[j];
                scratch[i] = value + (newest_b[i] * newest + middle_b[i] * middle + oldest_b[i] * oldest);
            }
            double value = bias[s];
            for (long i = 0; i < n; i++) {
                x[i] = fabs(scratch[i]) > tiny ? scratch[i] : 0.0;
                value += gain[i] * x[i];
            }
            output[row * systems + s] = value + (d[2 * s] * newest + d[2 * s + 1] * middle);
            position = position + 1 < length ? position + 1 : 0;
        }
    }
    return position;
}

static double curve(const double *p, long degree, double x)
{
    double value = p[0];
    for (long i = 1; i <= degree; i++)
        value = value * x + p[i];
    return value;
}

/* One axis of Madelung hysteresis with polynomial curves; the stack is large enough for the benchmark's signal. */
void madelung_branches(long rows, long degree, const double *source, const double *rising, const double *falling, double full,
                       const double *end_slope, double *stack, long *stack_depth, double *last, double *output)
{
    long depth = *stack_depth, moved_to_branch = 1;
    double u = last[0], y = last[1], direction = last[2], u_from = 0.0, y_from = 0.0, stretch = 0.0;
    for (long row = 0; row < rows; row++) {
        double raw = source[row];
        double x = raw < 0.0 ? 0.0 : raw > 1.0 ? 1.0 : raw;
        if (x != u) {
            double onward = x > u ? 1.0 : -1.0;
            if (onward != direction) {
                if (stack[2 * (depth - 1)] != u) {
                    stack[2 * depth] = u;
                    stack[2 * depth + 1] = y;
                    depth++;
                }
                direction = onward;
                moved_to_branch = 1;
            }
            if (x >= 1.0 || x <= 0.0) {
                u = x > 0.0 ? 1.0 : 0.0;
                y = x > 0.0 ? full : 0.0;
                stack[0] = 1.0 - u;
                stack[1] = full - y;
                stack[2] = u;
                stack[3] = y;
                depth = 2;
                moved_to_branch = 1;
            } else {
                while (depth > 2 && direction * (x - stack[2 * (depth - 2)]) >= 0.0) {
                    depth -= 2;
                    moved_to_branch = 1;
                }
                if (moved_to_branch) {
                    u_from = stack[2 * (depth - 1)];
                    y_from = stack[2 * (depth - 1) + 1];
                    double u_to = stack[2 * (depth - 2)], y_to = stack[2 * (depth - 2) + 1];
                    stretch = (y_to - y_from) / (direction > 0.0 ? curve(rising, degree, u_to - u_from)
                                                                 : curve(falling, degree, u_from - u_to));
                    moved_to_branch = 0;
                }
                y = y_from + stretch * (direction > 0.0 ? curve(rising, degree, x - u_from) : curve(falling, degree, u_from - x));
                u = x;
            }
        }
        double value = y;
        if (raw != x)
            value += (raw - x) * (raw > x ? end_slope[1] : end_slope[0]);
        output[row] = value;
    }
    *stack_depth = depth;
    last[0] = u;
    last[1] = y;
    last[2] = direction;
}
