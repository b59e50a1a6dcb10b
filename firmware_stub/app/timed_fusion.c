#include "timed_fusion.h"

#include "boards/cycle_counter.h"
#include "calibration/fast_code.h"

typedef fusion_status_t (*predict_t)(fusion_t *, const fusion_noise_t *, const float *, float);
typedef fusion_status_t (*update_t)(fusion_t *, const fusion_noise_t *, const float *, const float *);

FAST_CODE __attribute__((noinline)) static uint32_t
count_predict_cycles(predict_t predict, fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3], float dt_s,
                     fusion_status_t *status)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    *status = predict(state, noise, rate_rad_s, dt_s);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

FAST_CODE __attribute__((noinline)) static uint32_t
count_update_cycles(update_t update, fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                    const float field[3], fusion_status_t *status)
{
    const uint32_t mask = interrupts_mask();
    const uint32_t before = cycle_counter_read();
    *status = update(state, noise, gravity_g, field);
    const uint32_t after = cycle_counter_read();
    interrupts_restore(mask);
    return after - before;
}

static void add(step_costs_t *costs, uint32_t overhead_cycles, uint32_t cycles)
{
    const uint32_t alone = cycles - overhead_cycles; /* without a counter all readings are 0, and so is this */
    costs->steps++;
    costs->largest_cycles = alone > costs->largest_cycles ? alone : costs->largest_cycles;
    costs->total_cycles += alone;
    costs->overhead_cycles = overhead_cycles;
}

fusion_status_t timed_predict(step_costs_t *costs, fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3],
                              float dt_s)
{
    fusion_status_t status;
    const uint32_t overhead = count_predict_cycles(empty_fusion_predict, state, noise, rate_rad_s, dt_s, &status);
    add(costs, overhead, count_predict_cycles(fusion_predict, state, noise, rate_rad_s, dt_s, &status));
    return status;
}

fusion_status_t timed_update(step_costs_t *costs, fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                             const float field[3])
{
    fusion_status_t status;
    const uint32_t overhead = count_update_cycles(empty_fusion_update, state, noise, gravity_g, field, &status);
    add(costs, overhead, count_update_cycles(fusion_update, state, noise, gravity_g, field, &status));
    return status;
}
