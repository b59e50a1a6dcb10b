/**
 * @file stream_set.h
 * @brief The stream calibrators this board runs, each with its state.
 */
#ifndef HILTEST_STREAM_SET_H
#define HILTEST_STREAM_SET_H

#include "calibration/stream_calibrator.h"

/** Number of stream calibrators. */
uint8_t stream_set_count(void);

/** A stream calibrator; `index` below stream_set_count(). */
const stream_calibrator_t *stream_set_get(uint8_t index);

/** The stream calibrator of a name, NULL when there is none. */
const stream_calibrator_t *stream_set_find(const char *name, uint8_t length);

#endif
