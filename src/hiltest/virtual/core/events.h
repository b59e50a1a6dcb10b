/* Events that peripherals in C plan, and the clocks of their ticks. */
#ifndef HILTEST_EVENTS_H
#define HILTEST_EVENTS_H

#include <stdbool.h>
#include <stdint.h>

struct machine;

enum { PLANNED_EVENTS = 128, CLOCKS = 16, NO_CLOCK = -1 };
static const int64_t NEVER = INT64_MAX;

/* A clock of the part. Its ticks at a cycle are ticks + (remainder + (cycle - since) * numerator) / denominator,
 * rounded down. A clock with a numerator of 0 is stopped. */
struct clock {
    int64_t since, ticks, remainder, numerator, denominator;
};

static inline int64_t earlier(int64_t a, int64_t b) { return a < b ? a : b; }

int64_t clock_ticks(const struct clock *clock, int64_t cycle);
/* Return the first cycle at or after a tick; NEVER while the clock is stopped. */
int64_t clock_cycle(const struct clock *clock, int64_t tick);

/* The structure whose member FIELD is an event. */
#define OWNER(EVENT, TYPE, FIELD) ((TYPE *)(void *)((char *)(EVENT) - offsetof(TYPE, FIELD)))

/* An event of the queue, as a member of its peripheral's structure. Initially all members except `fire` are zero. */
struct event {
    void (*fire)(struct machine *machine, struct event *event);
    int64_t cycle;
    int64_t tick;     /* of `clock`, whose rate determines the cycle, unless it is NO_CLOCK */
    int32_t clock;
    bool is_planned;
};

/* The event queue, in order of cycles; events at the same cycle keep the order in which they were planned. */
struct calendar {
    struct event *events[PLANNED_EVENTS];
    int32_t count;
    int64_t time; /* due cycle of the firing event, from which new events are planned */
    struct clock clocks[CLOCKS];
    int32_t clock_count;
};

/* Plan an event, or replan it. The queue cannot overflow, because each peripheral has a fixed number of events. */
void plan_event(struct machine *machine, struct event *event, int64_t cycle);
void plan_event_at_tick(struct machine *machine, struct event *event, int32_t clock, int64_t tick);
void cancel_event(struct machine *machine, struct event *event);
/* Return the present ticks of a clock. */
int64_t ticks_now(const struct machine *machine, int32_t clock);
/* Advance a stopped clock by one tick, to count pulses. */
void tick_clock(struct machine *machine, int32_t clock);

#endif
