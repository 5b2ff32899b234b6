/* A thread that computes nothing: on one core, before the twin's clock, it sleeps until every tick of 0.5 ms.
 *
 *     idle_clock CORE SECONDS
 *
 * Prints "late DUE WOKEN" (s, CLOCK_MONOTONIC) for each wake that came over 0.1 ms late, then "ticks N MISSED
 * WORST": ticks, those that ended before it was awake, and the latest wake in s. Exit code 2 where the system
 * allows no real-time priority. */
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

enum { S_NS = 1000000000, TICK_NS = 500000, TOLD_NS = 100000, MOST_TOLD = 100000 };

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * S_NS + t.tv_nsec;
}

static int64_t late_ns(int64_t due_ns) {
    const struct timespec due = {due_ns / S_NS, due_ns % S_NS};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    return now_ns() - due_ns;
}

/* The twin's clock has the second lowest priority: this one is never kept waiting by it. */
static int go_there(int core) {
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET((size_t)core, &cores);
    const struct sched_param priority = {.sched_priority = sched_get_priority_min(SCHED_FIFO) + 2};
    return sched_setaffinity(0, sizeof cores, &cores) || sched_setscheduler(0, SCHED_FIFO, &priority) ||
           mlockall(MCL_CURRENT | MCL_FUTURE);
}

int main(int count, char **arguments) {
    static int64_t told[MOST_TOLD][2]; /* printed at the end: printing takes time */
    if (count != 3 || go_there(atoi(arguments[1]))) return 2;
    int64_t due_ns = now_ns(), ticks = 0, missed = 0, worst_ns = 0;
    const int64_t end_ns = due_ns + (int64_t)(atof(arguments[2]) * S_NS);
    int n = 0;
    while (due_ns < end_ns) {
        due_ns += TICK_NS;
        const int64_t by_ns = late_ns(due_ns), over = by_ns / TICK_NS;
        if (by_ns > TOLD_NS && n < MOST_TOLD) told[n][0] = due_ns, told[n++][1] = due_ns + by_ns;
        if (by_ns > worst_ns) worst_ns = by_ns;
        ticks += 1 + over;
        missed += over;
        due_ns += over * TICK_NS;
    }
    for (int i = 0; i < n; ++i)
        printf("late %.6f %.6f\n", 1e-9 * (double)told[i][0], 1e-9 * (double)told[i][1]);
    printf("ticks %lld %lld %.6f\n", (long long)ticks, (long long)missed, 1e-9 * (double)worst_ns);
    return 0;
}
