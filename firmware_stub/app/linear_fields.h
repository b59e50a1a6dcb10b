/**
 * @file linear_fields.h
 * @brief A 3x3 matrix and a vector, as every calibration travels.
 */
#ifndef HILTEST_LINEAR_FIELDS_H
#define HILTEST_LINEAR_FIELDS_H

#include <stddef.h>

#include "protocol/payload.h"

/** Read numbers; false when one is not finite. All are read. */
bool read_finite(payload_reader_t *request, float *values, size_t count);

/** Read a row-major matrix and the vector behind it. False when an element is not finite. */
bool read_linear(payload_reader_t *request, float matrix[9], float vector[3]);

/** Write a row-major matrix and the vector behind it. */
void write_linear(payload_writer_t *reply, const float matrix[9], const float vector[3]);

#endif
