#include "stillness.h"

#include <math.h>
#include <stdbool.h>

#define MEAN_LIMIT 6.0f
#define SPREAD_LIMIT 2.0f

void stillness_start(stillness_t *stillness, float noise)
{
    *stillness = (stillness_t){.noise = noise, .verdict = {.kind = STILLNESS_NOT_TESTED}};
}

/** Sample standard deviation of the window on an axis; the numbers under the root are exact. */
static float window_spread(const stillness_t *stillness, uint32_t axis)
{
    const int64_t count = STILLNESS_WINDOW;
    const int64_t sum = stillness->sum[axis];
    const int64_t scatter = count * stillness->sum_of_squares[axis] - sum * sum;
    return sqrtf((float)scatter / (float)(count * (count - 1)));
}

/** How far the mean of the window is from the mean of all before it, 0 when it is the first. */
static float window_deviation(const stillness_t *stillness, uint32_t axis)
{
    if (stillness->still_count == 0u) {
        return 0.0f;
    }
    const float before = (float)stillness->still_sum[axis] / (float)stillness->still_count;
    return (float)stillness->sum[axis] / (float)STILLNESS_WINDOW - before;
}

/** Test a whole window; of the axes that moved, the one that moved most is reported, and a turn before a shake. */
static void test_window(stillness_t *stillness)
{
    const float window = (float)STILLNESS_WINDOW;
    const float before = stillness->still_count == 0u ? window : (float)stillness->still_count;
    const float mean_limit = MEAN_LIMIT * stillness->noise * sqrtf(1.0f / window + 1.0f / before);
    const float spread_limit = SPREAD_LIMIT * stillness->noise;
    stillness_verdict_t turned = {.kind = STILLNESS_STILL, .first = stillness->begin};
    stillness_verdict_t shaken = turned;
    for (uint8_t axis = 0; axis < 3u; axis++) {
        const float deviation = window_deviation(stillness, axis);
        if (fabsf(deviation) > mean_limit && fabsf(deviation) > fabsf(turned.amount)) {
            turned.kind = STILLNESS_TURNED;
            turned.axis = axis;
            turned.amount = deviation;
        }
        const float spread = window_spread(stillness, axis);
        if (spread > spread_limit && spread > shaken.amount) {
            shaken.kind = STILLNESS_SHAKEN;
            shaken.axis = axis;
            shaken.amount = spread;
        }
    }
    stillness->verdict = turned.kind == STILLNESS_TURNED ? turned : shaken;
}

static void begin_window(stillness_t *stillness)
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        stillness->still_sum[axis] += stillness->sum[axis];
        stillness->sum[axis] = 0;
        stillness->sum_of_squares[axis] = 0;
    }
    stillness->still_count += STILLNESS_WINDOW;
    stillness->begin += STILLNESS_WINDOW;
    stillness->filled = 0;
}

/** Whether there is more to find: not without a noise to compare with, nor after a window that was not still. */
static bool goes_on(const stillness_t *stillness)
{
    const stillness_kind_t kind = stillness->verdict.kind;
    return stillness->noise > 0.0f && (kind == STILLNESS_NOT_TESTED || kind == STILLNESS_STILL);
}

void stillness_add(stillness_t *stillness, const int16_t sample[3])
{
    if (!goes_on(stillness)) {
        return;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int32_t value = sample[axis];
        stillness->sum[axis] += value;
        stillness->sum_of_squares[axis] += value * value;
    }
    stillness->filled++;
    if (stillness->filled == STILLNESS_WINDOW) {
        test_window(stillness);
        begin_window(stillness);
    }
}
