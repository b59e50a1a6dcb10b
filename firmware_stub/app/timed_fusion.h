/**
 * @file timed_fusion.h
 * @brief Steps of the fusion filter, and what they cost in core clock cycles.
 */
#ifndef HILTEST_TIMED_FUSION_H
#define HILTEST_TIMED_FUSION_H

#include <stdint.h>

#include "orientation/fusion.h"

/** What steps of one kind have cost; all zero is the start. */
typedef struct {
    uint32_t steps;
    uint32_t largest_cycles; /**< of one step; the cost of an empty one is subtracted here and below */
    uint32_t total_cycles;
    uint32_t overhead_cycles; /**< of the last empty step */
} step_costs_t;

/** fusion_predict(), counted as timed_run() counts calibrators. */
fusion_status_t timed_predict(step_costs_t *costs, fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3],
                              float dt_s);

/** fusion_update(), likewise. */
fusion_status_t timed_update(step_costs_t *costs, fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                             const float field[3]);

#endif
