#include "timed_fusion.h"

#include "boards/cycle_counter.h"
#include "calibration/fast_code.h"

typedef attitude_filter_status_t (*update_t)(attitude_filter_t *, const float *, const float *, const float *, float);

FAST_CODE __attribute__((noinline)) static uint32_t
count_update_cycles(update_t update, attitude_filter_t *state, const float rate_rad_s[3], const float gravity_g[3],
                    const float field[3], float dt_s, attitude_filter_status_t *status)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    *status = update(state, rate_rad_s, gravity_g, field, dt_s);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

attitude_filter_status_t timed_update(update_costs_t *costs, attitude_filter_t *state, const float rate_rad_s[3],
                                      const float gravity_g[3], const float field[3], float dt_s)
{
    attitude_filter_status_t status;
    const uint32_t overhead =
        count_update_cycles(empty_attitude_filter_update, state, rate_rad_s, gravity_g, field, dt_s, &status);
    const uint32_t cycles = count_update_cycles(attitude_filter_update, state, rate_rad_s, gravity_g, field, dt_s, &status);
    const uint32_t alone = cycles - overhead; /* without a counter all readings are 0, and so is this */
    costs->updates++;
    costs->largest_cycles = alone > costs->largest_cycles ? alone : costs->largest_cycles;
    costs->total_cycles += alone;
    costs->overhead_cycles = overhead;
    return status;
}
