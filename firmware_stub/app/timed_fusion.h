/**
 * @file timed_fusion.h
 * @brief Updates of the attitude filter, and what they cost in core clock cycles.
 */
#ifndef HILTEST_TIMED_FUSION_H
#define HILTEST_TIMED_FUSION_H

#include <stdint.h>

#include "orientation/attitude_filter.h"

/** The cost of updates; all zero at the start. */
typedef struct {
    uint32_t updates;
    uint32_t largest_cycles; /**< of one update; the cost of an empty one is subtracted here and below */
    uint32_t total_cycles;
    uint32_t overhead_cycles; /**< of the last empty update */
} update_costs_t;

/** attitude_filter_update(), counted as timed_run() counts calibrators. */
attitude_filter_status_t timed_update(update_costs_t *costs, attitude_filter_t *state, const float rate_rad_s[3],
                                      const float gravity_g[3], const float field[3], float dt_s);

#endif
