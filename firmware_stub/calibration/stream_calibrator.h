/**
 * @file stream_calibrator.h
 * @brief The interface of streaming calibrators: given one point at a time, asked when a fit is wanted.
 *
 * A stream calibrator keeps its state in a struct that its caller owns and does nothing else that can be seen: no I/O, no heap,
 * bounded time a point, no NaN in a calibration. A state of zeros is a state after reset.
 *
 * Counts are what the sensor gives, 0.1 uT each, in the body frame (x forward, y right, z down).
 */
#ifndef HILTEST_STREAM_CALIBRATOR_H
#define HILTEST_STREAM_CALIBRATOR_H

#include <stdbool.h>
#include <stdint.h>

#include "magnetometer_calibrator.h"

/** Whether a point was taken. The values are part of the link protocol. After anything but OK the state is as it was before. */
typedef enum {
    STREAM_OK = 0,
    STREAM_OUT_OF_RANGE, /**< further from the anchor than the sums have room for */
    STREAM_FULL,         /**< as many points are held as the sums have room for */
    STREAM_EMPTY,        /**< no point is held that could be removed */
} stream_status_t;

/** The state of knowledge of a stream calibrator after the points so far. */
typedef struct {
    magnetometer_fit_t fit;
    uint16_t held;           /**< points that the fit is, or would be, made of */
    uint8_t elements;        /**< unknowns of the solver whose calibration this is: 4, 7 or 10; 0 when there is but one */
    bool is_solving;         /**< a solver is at work, some of its slices done */
    uint32_t accepted;       /**< calibrations taken over since reset; 0 for one that fits when asked */
    float fit_error_percent; /**< the quality that the calibrator gives its calibration; negative when it has no such number */
} stream_report_t;

typedef stream_status_t (*stream_step_t)(void *state, const int16_t point[3]);
typedef void (*stream_reporter_t)(void *state, stream_report_t *report);

/** One stream calibrator, as the link knows it. `state` is of the type that the table names. */
typedef struct {
    const char *name;
    void *state;
    /** Forget all points. With `sliced` the solvers do one slice of their work a point; without slices it means nothing. */
    void (*reset)(void *state, bool sliced);
    stream_step_t add;
    /** Take a point back that was added before; NULL when the calibrator cannot. */
    stream_step_t remove;
    stream_reporter_t report;
} stream_calibrator_t;

/** Do nothing: what a call costs, subtracted from every measured cycle count. */
stream_status_t empty_stream_add(void *state, const int16_t point[3]);
void empty_stream_report(void *state, stream_report_t *report);

/* The four functions that a prefix of the table stands for; a header of a stream calibrator declares its own with it. */
#define STREAM_FUNCTIONS(prefix)                                               \
    void prefix##_reset(void *state, bool sliced);                             \
    stream_status_t prefix##_add(void *state, const int16_t point[3]);         \
    void prefix##_report(void *state, stream_report_t *report)

#endif
