/**
 * @file vector_statistics.h
 * @brief Mean and spread of vectors of counts, from exact integer sums.
 *
 * Sums of int16 and of their squares are exact in 64 bits for any number of samples here, so one pass gives what two passes in
 * double would, and the order of the samples cannot matter.
 */
#ifndef HILTEST_VECTOR_STATISTICS_H
#define HILTEST_VECTOR_STATISTICS_H

#include <stdint.h>

/** All zero is the start. At most 65535 vectors. */
typedef struct {
    int64_t sum[3];
    int64_t sum_of_squares[3];
    uint16_t count;
} vector_statistics_t;

void statistics_add(vector_statistics_t *statistics, const int16_t vector[3]);

/** Mean of each axis [counts]; NaN without samples. */
void statistics_mean(const vector_statistics_t *statistics, float mean[3]);

/** Sample standard deviation (n - 1) of each axis [counts]; NaN for fewer than two samples. */
void statistics_spread(const vector_statistics_t *statistics, float spread[3]);

#endif
