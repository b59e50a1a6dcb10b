#include "timed_run.h"

#include "boards/cycle_counter.h"
#include "calibration/fast_code.h"

static bool has_counter;

void timed_run_start(void)
{
    has_counter = cycle_counter_start();
}

bool timed_run_has_counter(void)
{
    return has_counter;
}

/** The one piece of code that every count goes through: what it costs itself is the same for all and is subtracted. */
FAST_CODE __attribute__((noinline)) static uint32_t
count_cycles(magnetometer_calibrator_t calibrator, const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    calibrator(points, fit);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

run_cost_t timed_run(magnetometer_calibrator_t calibrator, const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    run_cost_t cost = {.overhead_cycles = count_cycles(magnetometer_empty, points, fit)};
    const uint32_t total = count_cycles(calibrator, points, fit);
    cost.cycles = total - cost.overhead_cycles; /* without a counter all readings are 0, and so is this */
    return cost;
}

static FAST_CODE void empty_work(const void *task, void *result)
{
    (void)task;
    (void)result;
}

FAST_CODE __attribute__((noinline)) static uint32_t count_work_cycles(timed_work_t work, const void *task, void *result)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    work(task, result);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

run_cost_t timed_work(timed_work_t work, const void *task, void *result)
{
    run_cost_t cost = {.overhead_cycles = count_work_cycles(empty_work, task, result)};
    const uint32_t total = count_work_cycles(work, task, result);
    cost.cycles = total - cost.overhead_cycles;
    return cost;
}

FAST_CODE __attribute__((noinline)) static uint32_t
count_step_cycles(stream_step_t step, void *state, const int16_t point[3], stream_status_t *status)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    *status = step(state, point);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

run_cost_t timed_step(stream_step_t step, void *state, const int16_t point[3], stream_status_t *status)
{
    run_cost_t cost = {.overhead_cycles = count_step_cycles(empty_stream_add, state, point, status)};
    const uint32_t total = count_step_cycles(step, state, point, status);
    cost.cycles = total - cost.overhead_cycles;
    return cost;
}

FAST_CODE __attribute__((noinline)) static uint32_t
count_report_cycles(stream_reporter_t reporter, void *state, stream_report_t *report)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    reporter(state, report);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

run_cost_t timed_report(stream_reporter_t reporter, void *state, stream_report_t *report)
{
    run_cost_t cost = {.overhead_cycles = count_report_cycles(empty_stream_report, state, report)};
    const uint32_t total = count_report_cycles(reporter, state, report);
    cost.cycles = total - cost.overhead_cycles;
    return cost;
}
