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
