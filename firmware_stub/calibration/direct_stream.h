/**
 * @file direct_stream.h
 * @brief `direct-stream`: the closed-form fit of `direct` over exact sums that points enter and leave.
 *
 * The equations are those of direct.c (Mucciaccia 2020, eq. 36 to 65, corrected); the integer sums are our own.
 *
 * The first point after reset, or after the last one left, is the anchor that coordinates are relative to. Each point enters its
 * 34 monomials into integer sums and can be taken away again to the last bit, so a window over the newest N points never drifts:
 * add the new one, remove the oldest. The caller keeps the points; the state is the same size for any number of them.
 */
#ifndef HILTEST_DIRECT_STREAM_H
#define HILTEST_DIRECT_STREAM_H

#include "exact_moments.h"
#include "stream_calibrator.h"

typedef struct {
    exact_moments_t sums; /**< about the anchor */
    int16_t anchor[3];    /**< [counts] */
    uint16_t held;        /**< points in the sums, at most EXACT_MOMENTS_POINTS */
} direct_stream_t;

STREAM_FUNCTIONS(direct_stream);
stream_status_t direct_stream_remove(void *state, const int16_t point[3]);

#endif
