/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Made by hyst export. Replays the golden vectors of {{ name }}, saves and restores its state, and times a step. Exit status 0 where all is as in Python.
   With STEPS, as many steps come first whose inputs nobody should send: nothing of them may be left afterwards. */
#define _POSIX_C_SOURCE 199309L
#include "{{ name }}.h"

#include "{{ name }}_golden.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#ifndef EXACT
#define EXACT 1 /* 0: another library's exp, sin or pow may differ in the last digit */
#endif
#ifndef STEPS
#define STEPS 0
#endif
#ifndef TURNS
#define TURNS 20000 /* that are timed */
#endif

enum { INPUTS = {{ upper }}_INPUTS, OUTPUTS = {{ upper }}_OUTPUTS };

static {{ name }}_real given[ROWS][INPUTS];
static {{ name }}_real found[ROWS][OUTPUTS];
static {{ name }}_real again[ROWS][OUTPUTS];
static double spent[TURNS];

#if defined(__x86_64__) || defined(__i386__)
static const char *const UNIT = "cycles";
static double now(void)
{
    return (double)__builtin_ia32_rdtsc();
}
#else
static const char *const UNIT = "ns";
static double now(void)
{
    struct timespec time;
    (void)clock_gettime(CLOCK_MONOTONIC, &time);
    return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}
#endif

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Values that differ from Python: in any bit in double, by more than 1e-5 of the column's range, or a fifth of its size, in float. */
static int wrong_values(int exact)
{
    int wrong = 0;
    for (int column = 0; column < OUTPUTS; column++) {
        double low = golden_out[0][column], high = low;
        for (int row = 0; row < ROWS; row++) {
            low = fmin(low, golden_out[row][column]);
            high = fmax(high, golden_out[row][column]);
        }
        const double size = fmax(high - low, 0.2 * fmax(fabs(low), fabs(high)));
        const double most = exact ? 0.0 : ({{ upper }}_FLOAT ? 1e-5 : 1e-9) * size;
        for (int row = 0; row < ROWS; row++) {
            const double x = golden_out[row][column], y = (double)found[row][column];
            if (!(fabs(x - y) <= most) && !(isnan(x) && isnan(y))) {
                if (wrong == 0) {
                    printf("row %d, output %d: %a, Python has %a\n", row, column, y, x);
                }
                wrong++;
            }
        }
    }
    return wrong;
}

static unsigned int drawn(unsigned int below)
{
    static unsigned long long last = 25ULL;
    last = (last * 6364136223846793005ULL) + 1442695040888963407ULL;
    return (unsigned int)(last >> 33) % below;
}

/* NaN, infinities, denormal and absurd numbers, and any in between. */
static {{ name }}_real odd_number(void)
{
    const double largest = {{ upper }}_FLOAT ? (double)FLT_MAX : DBL_MAX, least = {{ upper }}_FLOAT ? 1e-45 : 5e-324;
    const double numbers[] = {0.0, -0.0, (double)NAN, (double)INFINITY, -(double)INFINITY, least, -least, largest, -largest};
    const unsigned int count = (unsigned int)(sizeof numbers / sizeof numbers[0]), which = drawn(2 * count);
    const int widest = {{ upper }}_FLOAT ? 127 : 1023;
    const double other = ldexp((double)drawn(2000001) / 1e6 - 1.0, (int)drawn(2U * (unsigned int)widest) - widest);
    return ({{ name }}_real)(which < count ? numbers[which] : other);
}

/* Steps whose inputs are golden ones in any order, one odd number among such, or odd numbers only; each kind for a while. */
static int wrong_steps({{ name }}_state *state, int steps)
{
    {{ name }}_real in[INPUTS], out[OUTPUTS];
    int wrong = 0;
    unsigned int kind = 0;
    for (int step = 0; step < steps; step++) {
        const unsigned int row = drawn(ROWS), odd = drawn(INPUTS);
        kind = drawn(50) == 0 ? drawn(3) : kind;
        for (unsigned int i = 0; i < (unsigned int)INPUTS; i++) {
            in[i] = kind == 2 || (kind == 1 && i == odd) ? odd_number() : given[row][i];
        }
        {{ name }}_step(state, in, out);
{% if limits %}
        for (int i = 0; i < {{ limits[0] }}; i++) {
            wrong += !(out[i] >= ({{ name }}_real){{ limits[1] }} && out[i] <= ({{ name }}_real){{ limits[2] }});
        }
{% endif %}
    }
    if (steps > 0) {
        printf("%d odd steps{% if limits %}, %d commands beyond the limits{% endif %}; ", steps{% if limits %}, wrong{% endif %});
    }
    return wrong;
}

int main(void)
{
    static {{ name }}_state state, saved;
    const int exact = EXACT && !{{ upper }}_FLOAT;
    {{ name }}_real start[OUTPUTS];
    int wrong = 0;
    for (int row = 0; row < ROWS; row++) {
        for (int i = 0; i < INPUTS; i++) {
            given[row][i] = ({{ name }}_real)golden_in[row][i];
        }
    }
    {{ name }}_init(&state);
    wrong += wrong_steps(&state, STEPS);
    {{ name }}_settle(&state, given[0], found[0]);
    for (int row = 1; row < ROWS; row++) {
        if (row == ROWS / 3) {
            saved = state;
            {{ name }}_init(&state); /* all is lost, and restored */
            state = saved;
        }
        {{ name }}_step(&state, given[row], found[row]);
    }
    wrong += wrong_values(exact);
    {{ name }}_settle(&state, given[0], again[0]);
    {{ name }}_block(&state, given[1], again[1], ROWS - 1);
    for (int row = 0; row < ROWS; row++) {
        for (int i = 0; i < OUTPUTS; i++) {
            const {{ name }}_real x = found[row][i], y = again[row][i];
            wrong += !((x >= y && x <= y) || (isnan(x) && isnan(y)));
        }
    }
    for (int turn = 0; turn < TURNS; turn++) {
        const double begin = now();
        {{ name }}_step(&state, given[turn % ROWS], start);
        spent[turn] = now() - begin;
    }
    qsort(spent, TURNS, sizeof spent[0], ascending);
    printf("{{ name }} in %s: %d rows, %d wrong, state %d bytes, a step %.0f %s (median), %.0f (99.9 %%), %.0f (maximum)\n",
           {{ upper }}_FLOAT ? "float" : "double", (int)ROWS, wrong, (int)sizeof state, spent[TURNS / 2], UNIT,
           spent[TURNS - TURNS / 1000], spent[TURNS - 1]);
    return wrong ? EXIT_FAILURE : EXIT_SUCCESS;
}
