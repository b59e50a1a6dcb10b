#include "vector_statistics.h"

#include <math.h>

void statistics_add(vector_statistics_t *statistics, const int16_t vector[3])
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int32_t value = vector[axis];
        statistics->sum[axis] += value;
        statistics->sum_of_squares[axis] += value * value;
    }
    statistics->count++;
}

void statistics_mean(const vector_statistics_t *statistics, float mean[3])
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        mean[axis] = statistics->count == 0u ? NAN : (float)statistics->sum[axis] / (float)statistics->count;
    }
}

void statistics_spread(const vector_statistics_t *statistics, float spread[3])
{
    const int64_t count = statistics->count;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        if (count < 2) {
            spread[axis] = NAN;
            continue;
        }
        /* n * sum(x^2) - sum(x)^2 is at most 2^62 for 2^16 samples of 2^15, so it is exact. */
        const int64_t sum = statistics->sum[axis];
        const int64_t scatter = count * statistics->sum_of_squares[axis] - sum * sum;
        spread[axis] = sqrtf((float)scatter / ((float)count * (float)(count - 1)));
    }
}
