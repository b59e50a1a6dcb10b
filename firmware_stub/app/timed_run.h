/**
 * @file timed_run.h
 * @brief The cost of a calibrator, in core clock cycles.
 */
#ifndef HILTEST_TIMED_RUN_H
#define HILTEST_TIMED_RUN_H

#include <stdbool.h>

#include "calibration/magnetometer_calibrator.h"
#include "calibration/stream_calibrator.h"

typedef struct {
    uint32_t cycles;          /**< of the calibrator alone; 0 when this core has no cycle counter */
    uint32_t overhead_cycles; /**< of calling an empty calibrator the same way; already subtracted */
} run_cost_t;

/** Start the cycle counter; call once. */
void timed_run_start(void);

/** Whether cycles are counted on this core. */
bool timed_run_has_counter(void);

/**
 * Run a calibrator and count its cycles.
 *
 * Interrupts are masked while it runs, so nothing else is counted. Bytes that arrive meanwhile wait in the UART's FIFO for up to
 * 0.7 ms and are lost after that: the host does not send while it waits for a reply.
 */
run_cost_t timed_run(magnetometer_calibrator_t calibrator, const magnetometer_points_t *points, magnetometer_fit_t *fit);

/** Fast code that is neither a calibrator nor a stream's step: `task` and `result` are its own. */
typedef void (*timed_work_t)(const void *task, void *result);

/** Do a piece of work and count likewise. */
run_cost_t timed_work(timed_work_t work, const void *task, void *result);

/** Give a point to a stream calibrator's add or remove, or take its report, and count likewise. */
run_cost_t timed_step(stream_step_t step, void *state, const int16_t point[3], stream_status_t *status);
run_cost_t timed_report(stream_reporter_t reporter, void *state, stream_report_t *report);

#endif
