/**
 * @file stillness.h
 * @brief Whether a gyroscope lay still, and if not since when and about which axis.
 *
 * Samples are taken together in windows. A window is not still when its mean is further from the mean of all windows before it than
 * six times what noise makes of such a difference (once in a billion for a normal one), or when it is more than twice as noisy
 * as declared: 20 samples of the declared noise are with a probability below 1e-12. A rotation that is there from the first window
 * on, and stays, is bias to a gyroscope: no test of its own samples can tell.
 */
#ifndef HILTEST_STILLNESS_H
#define HILTEST_STILLNESS_H

#include <stdint.h>

/** Samples of a window: 0.1 s at 200 Hz. */
#define STILLNESS_WINDOW 20u

typedef enum {
    STILLNESS_STILL = 0,
    STILLNESS_TURNED = 1,     /**< the mean of a window is another than before */
    STILLNESS_SHAKEN = 2,     /**< a window is noisier than the sensor */
    STILLNESS_NOT_TESTED = 3, /**< no window was tested: the noise was given as 0, or there are too few samples for one */
} stillness_kind_t;

/** The first window that is not still. */
typedef struct {
    stillness_kind_t kind;
    uint8_t axis;        /**< 0, 1, 2 for x, y, z: where the window is furthest from still */
    uint32_t first;      /**< sample with which the window begins, counted from 0 */
    float amount;        /**< how far its mean is from the one before, with sign, or its spread [counts] */
} stillness_verdict_t;

typedef struct {
    float noise; /**< rms of one sample, were all samples independent [counts] */
    stillness_verdict_t verdict;
    int64_t still_sum[3]; /**< of all windows found still */
    uint32_t still_count; /**< samples of these */
    uint32_t begin;       /**< sample with which the window under way begins */
    uint8_t filled;       /**< samples in it */
    int32_t sum[3];
    int64_t sum_of_squares[3];
} stillness_t;

/** Begin. @param noise as stillness_t has it; 0 tests nothing */
void stillness_start(stillness_t *stillness, float noise);

/** Add a sample. A window that is not full at the end is not tested. */
void stillness_add(stillness_t *stillness, const int16_t sample[3]);

#endif
