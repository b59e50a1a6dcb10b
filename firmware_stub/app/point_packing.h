/**
 * @file point_packing.h
 * @brief What storing a point costs when `direct-fast` is to be fast, and points packed for it about a known centre.
 */
#ifndef HILTEST_POINT_PACKING_H
#define HILTEST_POINT_PACKING_H

#include "calibration/magnetometer_calibrator.h"
#include "calibration/packed_points.h"

/** Of all points together, without the empty steps. */
typedef struct {
    uint32_t range_cycles;    /**< to keep their range */
    uint32_t packing_cycles;  /**< to pack them */
    uint32_t overhead_cycles; /**< of the empty steps, subtracted already */
} packing_cost_t;

/** Forget what was packed, and pack points as they are stored from now on, about a centre [counts]. */
void point_packing_start(const int16_t centre[3]);

/** Pack a point that is stored as the one of this index, if points are packed and none before it is missing. */
void point_packing_store(uint16_t index, const int16_t point[3]);

/** Store points again, one by one, as if the centre [counts] had been known when they came. Points after them are not packed. */
packing_cost_t point_packing_run(const magnetometer_points_t *points, const int16_t centre[3]);

/** The points that were packed, if they were so many; else NULL. */
packed_points_t *point_packing_of(uint16_t count);

/** Forget what was packed, and pack no more. */
void point_packing_forget(void);

#endif
