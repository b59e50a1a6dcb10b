#include "events.h"

#include <string.h>

#include "state.h"

/* Whole ticks of each cycle, and of each `denominator` cycles, are counted separately: no product is larger than the
 * ticks themselves, or than machine_set_clock allows. */
int64_t clock_ticks(const struct clock *clock, int64_t cycle)
{
    int64_t passed = cycle - clock->since, rest = clock->numerator % clock->denominator;
    int64_t parts = clock->remainder + passed % clock->denominator * rest;
    int64_t whole = passed * (clock->numerator / clock->denominator) + passed / clock->denominator * rest;
    return clock->ticks + whole + parts / clock->denominator - (parts % clock->denominator < 0);
}

int64_t clock_cycle(const struct clock *clock, int64_t tick)
{
    int64_t ahead = tick - clock->ticks;
    if (!clock->numerator)
        return ahead > 0 ? NEVER : clock->since;
    int64_t rounds = ahead / clock->numerator; /* of `denominator` cycles */
    if (rounds > INT64_MAX / 2 / clock->denominator)
        return NEVER;
    int64_t parts = ahead % clock->numerator * clock->denominator - clock->remainder;
    int64_t cycles = parts / clock->numerator + (parts % clock->numerator > 0);
    return clock->since + rounds * clock->denominator + cycles;
}

int64_t ticks_now(const struct machine *machine, int32_t clock)
{
    return clock_ticks(&machine->calendar.clocks[clock], machine->core.cycles);
}

/* -- the event queue ---------------------------------------------------------------------------------------------- */

static void insert_event(struct calendar *calendar, struct event *event)
{
    int32_t place = calendar->count;
    while (place > 0 && calendar->events[place - 1]->cycle > event->cycle)
        place--;
    memmove(
        &calendar->events[place + 1], &calendar->events[place],
        (size_t)(calendar->count - place) * sizeof calendar->events[0]);
    calendar->events[place] = event;
    calendar->count++;
    event->is_planned = true;
}

void cancel_event(struct machine *machine, struct event *event)
{
    struct calendar *calendar = &machine->calendar;
    if (!event->is_planned)
        return;
    int32_t place = 0;
    while (place < calendar->count && calendar->events[place] != event)
        place++;
    event->is_planned = false;
    if (place == calendar->count)
        return;
    calendar->count--;
    memmove(
        &calendar->events[place], &calendar->events[place + 1],
        (size_t)(calendar->count - place) * sizeof calendar->events[0]);
}

void plan_event(struct machine *machine, struct event *event, int64_t cycle)
{
    cancel_event(machine, event);
    if (machine->calendar.count == PLANNED_EVENTS)
        return;
    event->cycle = cycle;
    event->clock = NO_CLOCK;
    insert_event(&machine->calendar, event);
}

void plan_event_at_tick(struct machine *machine, struct event *event, int32_t clock, int64_t tick)
{
    plan_event(machine, event, clock_cycle(&machine->calendar.clocks[clock], tick));
    event->clock = clock;
    event->tick = tick;
}

int64_t machine_next_event(const struct machine *machine)
{
    return machine->calendar.count ? machine->calendar.events[0]->cycle : NEVER;
}

void machine_fire_events(struct machine *machine)
{
    struct calendar *calendar = &machine->calendar;
    while (calendar->count && calendar->events[0]->cycle <= machine->core.cycles) {
        struct event *event = calendar->events[0];
        calendar->time = event->cycle;
        cancel_event(machine, event);
        machine->has_fired = true;
        forget_answers(machine);
        event->fire(machine, event);
    }
}

/* -- clocks ------------------------------------------------------------------------------------------------------- */

int32_t machine_add_clock(struct machine *machine)
{
    struct calendar *calendar = &machine->calendar;
    if (calendar->clock_count == CLOCKS)
        return -1;
    calendar->clocks[calendar->clock_count].denominator = 1;
    return calendar->clock_count++;
}

/* Recompute the cycles of a clock's events after a change of its rate; the order of equal cycles is stable. */
static void replan_events(struct machine *machine, int32_t clock)
{
    struct calendar *calendar = &machine->calendar;
    struct event *events[PLANNED_EVENTS];
    int32_t count = calendar->count;
    memcpy(events, calendar->events, (size_t)count * sizeof events[0]);
    calendar->count = 0;
    for (int32_t i = 0; i < count; i++) {
        if (events[i]->clock == clock)
            events[i]->cycle = clock_cycle(&calendar->clocks[clock], events[i]->tick);
        insert_event(calendar, events[i]);
    }
}

void machine_set_clock(
    struct machine *machine, int32_t clock, int64_t since, int64_t ticks, int64_t remainder, int64_t numerator,
    int64_t denominator)
{
    machine->calendar.clocks[clock] = (struct clock){since, ticks, remainder, numerator, denominator};
    replan_events(machine, clock);
}

void tick_clock(struct machine *machine, int32_t clock)
{
    machine_set_clock(machine, clock, machine->core.cycles, ticks_now(machine, clock) + 1, 0, 0, 1);
}
