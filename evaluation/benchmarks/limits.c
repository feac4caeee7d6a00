/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* What the operating system can do with nothing around it, for the figures of `hyst bench`. */
#define _GNU_SOURCE
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { MOST = 64 };

static double seconds(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* One member of a ring waits for its event and wakes the next one, so many times. */
static int passed(int own, int next, int rounds)
{
    uint64_t got, one = 1;
    for (int round = 0; round < rounds; round++)
        if (read(own, &got, sizeof got) != sizeof got || write(next, &one, sizeof one) != sizeof one)
            return 1;
    return 0;
}

/* Seconds of a round of processes that wake each other by eventfd, each of them once a round. */
double ring(int processes, int rounds)
{
    int events[MOST];
    const uint64_t one = 1;
    for (int i = 0; i < processes; i++)
        events[i] = eventfd(0, 0);
    pid_t members[MOST];
    for (int i = 1; i < processes; i++)
        if ((members[i] = fork()) == 0)
            _exit(passed(events[i], events[(i + 1) % processes], rounds));
    const double begin = seconds(CLOCK_MONOTONIC);
    if (write(events[0], &one, sizeof one) == sizeof one)
        (void)passed(events[0], events[1 % processes], rounds);
    const double spent = seconds(CLOCK_MONOTONIC) - begin;
    for (int i = 1; i < processes; i++)
        (void)waitpid(members[i], NULL, 0);
    for (int i = 0; i < processes; i++)
        (void)close(events[i]);
    return spent / rounds;
}

/* Times (s) since the timer began at which a thread that waits for it was awake; the share of a core that it takes. */
double timer(double period, int ticks, int priority, double *awake, int *realtime)
{
    const struct sched_param wanted = {priority}, usual = {0};
    const long nanoseconds = (long)(1e9 * period);
    const struct itimerspec each = {{0, nanoseconds}, {0, nanoseconds}};
    const int file = timerfd_create(CLOCK_MONOTONIC, 0);
    uint64_t expired;
    *realtime = priority > 0 && sched_setscheduler(0, SCHED_FIFO, &wanted) == 0;
    const double begin = seconds(CLOCK_MONOTONIC), busy = seconds(CLOCK_THREAD_CPUTIME_ID);
    (void)timerfd_settime(file, 0, &each, NULL);
    for (int tick = 0; tick < ticks && read(file, &expired, sizeof expired) == sizeof expired; tick++)
        awake[tick] = seconds(CLOCK_MONOTONIC) - begin;
    const double share = (seconds(CLOCK_THREAD_CPUTIME_ID) - busy) / awake[ticks - 1];
    if (*realtime)
        (void)sched_setscheduler(0, SCHED_OTHER, &usual);
    (void)close(file);
    return share;
}

/* HAMPI's feedforward and PI feedback of one axis as one would write it for this case alone, and its state. */
struct loop {
    double a[ORDER][ORDER], b[ORDER], c[ORDER], d, threshold[PLAYS], release[PLAYS], weight[PLAYS];
    double w0, m1, m2, k, bias, gain, rate_factor, most, kp, ki, lower, upper, step, share;
    double x[ORDER], newest, play[PLAYS], previous, feedforward, integral, command;
};

void loop(int rows, int ahead, const double *reference, const double *measurement, struct loop *s, double *command)
{
    for (int row = 0; row < rows; row++) {
        double next[ORDER], demand = s->d * reference[row], u = s->feedforward;
        for (int i = 0; i < ORDER; i++) {
            next[i] = s->b[i] * s->newest;
            for (int j = 0; j < ORDER; j++)
                next[i] += s->a[i][j] * s->x[j];
        }
        for (int i = 0; i < ORDER; i++)
            demand += s->c[i] * (s->x[i] = next[i]);
        s->newest = reference[row];
        const double rate = (demand - s->previous) * s->rate_factor;
        const double rotation = fmin(fmax(rate >= 0.0 ? -s->m1 * rate : s->m2 * rate, -s->most), s->most);
        s->previous = demand;
        for (int turn = 0; turn < TURNS; turn++) {
            double total = 0.0, weighted = 0.0;
            for (int i = 0; i < PLAYS; i++) {
                const double h = fmax(u - s->threshold[i], fmin(u + s->release[i], s->play[i]));
                total += h;
                weighted += s->weight[i] * h;
            }
            u += s->gain * (demand - (s->w0 * u + weighted + (rotation + s->k * u + s->bias) * total));
            u = fmin(fmax(u, s->lower), s->upper);
        }
        for (int i = 0; i < PLAYS; i++)
            s->play[i] = fmax(u - s->threshold[i], fmin(u + s->release[i], s->play[i]));
        s->feedforward = u;
        const double error = reference[row > ahead ? row - ahead : 0] - measurement[row];
        s->integral += s->ki * error;
        const double wanted = u + s->kp * error + s->integral;
        const double limited = fmin(fmax(wanted, s->lower), s->upper);
        s->command = command[row] = fmin(fmax(limited, s->command - s->step), s->command + s->step);
        s->integral += (s->command - wanted) * s->share;
    }
}
