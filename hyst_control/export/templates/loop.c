/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Made by hyst export. Closes the loop of {{ name }} against {{ plant }} on the wall clock, under SCHED_FIFO where that is allowed:  {{ name }}_main [SECONDS [HZ]] */
#define _GNU_SOURCE
#include "{{ name }}.h"

#include "{{ plant }}.h"

#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

enum { AXES = {{ plant_upper }}_INPUTS, AHEAD = {{ ahead }}, MOST = 2000000 };

static const double MIDDLE[AXES] = { {{ middle }} };
static const double AMPLITUDE[AXES] = { {{ amplitude }} };
static double late[MOST];
static double spent[MOST];

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double between(const struct timespec *from, const struct timespec *to)
{
    return 1e6 * (double)(to->tv_sec - from->tv_sec) + 1e-3 * (double)(to->tv_nsec - from->tv_nsec);
}

/* From the rest at the lower end, a sine. */
static double reference(int axis, int tick, double frequency)
{
    const double phase = 2.0 * acos(-1.0) * frequency * {{ upper }}_SAMPLE_TIME * (double)(tick > 0 ? tick : 0);
    return MIDDLE[axis] - AMPLITUDE[axis] * cos(phase);
}

int main(int count, char **words)
{
    const double seconds = count > 1 ? atof(words[1]) : 2.0, frequency = count > 2 ? atof(words[2]) : 10.0;
    const double period = 1e9 * {{ upper }}_SAMPLE_TIME;
    const int ticks = (int)fmin(seconds / {{ upper }}_SAMPLE_TIME, (double)MOST);
    static {{ name }}_state controller;
    static {{ plant }}_state plant;
    {{ name }}_real in[{{ upper }}_INPUTS], out[{{ upper }}_OUTPUTS];
    {{ plant }}_real command[AXES], measurement[{{ plant_upper }}_OUTPUTS];
    const struct sched_param priority = {80};
    const int fifo = sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    struct timespec due, begin, end;
    double squares = 0.0, range = 0.0;
    int faults = 0, compared = 0;
    if (ticks < 2) {
        fprintf(stderr, "usage: {{ name }}_main [SECONDS [HZ]]: at least two ticks\n");
        return 2;
    }
    (void)mlockall(MCL_CURRENT | MCL_FUTURE);
    {{ name }}_init(&controller);
    for (int axis = 0; axis < AXES; axis++) {
        command[axis] = 0;
    }
    {{ plant }}_settle(&plant, command, measurement);
    (void)clock_gettime(CLOCK_MONOTONIC, &due);
    for (int tick = 0; tick < ticks; tick++) {
        due.tv_nsec += (long)period;
        while (due.tv_nsec >= 1000000000L) {
            due.tv_nsec -= 1000000000L;
            due.tv_sec++;
        }
        (void)clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        (void)clock_gettime(CLOCK_MONOTONIC, &begin);
        for (int axis = 0; axis < AXES; axis++) {
            in[axis] = ({{ name }}_real)reference(axis, tick, frequency);
            in[AXES + axis] = ({{ name }}_real)measurement[axis];
            if (tick >= ticks / 2) {
                const double error = (double)measurement[axis] - reference(axis, tick - AHEAD, frequency);
                squares += error * error;
                range = fmax(range, 2.0 * AMPLITUDE[axis]);
                compared++;
            }
        }
        in[2 * AXES] = 1;
        {{ name }}_step(&controller, in, out);
        (void)clock_gettime(CLOCK_MONOTONIC, &end);
        faults += out[3 * AXES] > 0;
        for (int axis = 0; axis < AXES; axis++) {
            command[axis] = ({{ plant }}_real)out[axis];
        }
        {{ plant }}_step(&plant, command, measurement);
        late[tick] = between(&due, &begin);
        spent[tick] = between(&begin, &end);
    }
    qsort(late, (size_t)ticks, sizeof late[0], ascending);
    qsort(spent, (size_t)ticks, sizeof spent[0], ascending);
    printf("%d ticks at %.0f Hz, %s: late %.1f us (median), %.1f (99.9 %%), %.1f (maximum); a step %.2f us (median), %.2f (99.9 %%)\n",
           ticks, 1.0 / {{ upper }}_SAMPLE_TIME, fifo ? "SCHED_FIFO" : "default scheduler", late[ticks / 2], late[ticks - 1 - ticks / 1000],
           late[ticks - 1], spent[ticks / 2], spent[ticks - 1 - ticks / 1000]);
    printf("error %.4f %% of the range (rms), %d ticks with a fault\n", 100.0 * sqrt(squares / compared) / range, faults);
    return faults ? EXIT_FAILURE : EXIT_SUCCESS;
}
