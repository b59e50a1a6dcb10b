/**
 * @file fit_fields.h
 * @brief A fit as it stands in the replies that have one.
 */
#ifndef HILTEST_FIT_FIELDS_H
#define HILTEST_FIT_FIELDS_H

#include "calibration/magnetometer_calibrator.h"
#include "protocol/payload.h"

/** Write status, flags (bit 0 is the sphere's; the others are the caller's), iterations, soft iron, hard iron and coverage. */
void write_fit(payload_writer_t *reply, const magnetometer_fit_t *fit, uint8_t flags);

#endif
