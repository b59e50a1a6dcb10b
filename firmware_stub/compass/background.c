/**
 * @file background.c @brief Calibration from what the compass sees in use: nobody says when to begin.
 *
 * Points are kept that lie apart. All are as far from the centre as the earth's field is strong, wherever hard iron has put that
 * centre; so points that lie apart spread over all directions, and the centre need not be known.
 */
#include <math.h>
#include <string.h>

#include "calibration/magnetometer_calibrator.h"
#include "calibration/point_range.h"
#include "compass.h"

#define SPACING 120.0f           /* [counts] 12 uT: 14 degrees in a field of 48 uT, and some 120 points on the sphere */
#define RENEW_AFTER 4800u        /* [samples] a minute: iron may change, and old points must not outlive that for ever */
#define POINTS_FOR_A_FIT 30u
#define CHANGES_FOR_A_FIT 8u     /* a fit takes 0.1 ms, so it may come often */
#define WORST_COVERAGE 4.0f      /* of a whole sphere at most 1.7, of half a one at least 6 */
#define WORST_ERROR_PERCENT 2.0f /* noise of 0.4 uT makes 0.8; more means that the points do not belong together */

/** Keep a sample that lies apart from all points, or in place of the only one near it when that is old. */
static bool keep(background_t *background, const int16_t sample[3])
{
    uint32_t near = 0, place = background->count;
    for (uint32_t i = 0; i < background->count; i++) {
        const int16_t *const point = background->points[i];
        const float x = (float)(sample[0] - point[0]), y = (float)(sample[1] - point[1]), z = (float)(sample[2] - point[2]);
        if (x * x + y * y + z * z < SPACING * SPACING) {
            place = i;
            near++;
        }
    }
    if (near > 1u || place == POINTS_KEPT || (near == 1u && background->samples < background->taken_at[place] + RENEW_AFTER)) {
        return false;
    }
    memcpy(background->points[place], sample, sizeof background->points[place]);
    background->taken_at[place] = background->samples;
    background->count += near == 0u;
    return true;
}

void iron_remove(const iron_t *iron, const float raw[3], float field[3])
{
    const float *row = iron->soft_iron, *const h = iron->hard_iron, x = raw[0] - h[0], y = raw[1] - h[1], z = raw[2] - h[2];
    for (uint32_t axis = 0; axis < 3u; axis++, row += 3) {
        field[axis] = row[0] * x + row[1] * y + row[2] * z;
    }
}

/** Rms by which the corrected points miss the sphere [%]. */
static float error_percent(const background_t *background, const iron_t *iron)
{
    float sum = 0.0f;
    for (uint32_t i = 0; i < background->count; i++) {
        const int16_t *const point = background->points[i];
        float field[3];
        iron_remove(iron, (const float[3]){point[0], point[1], point[2]}, field);
        const float miss = sqrtf(field[0] * field[0] + field[1] * field[1] + field[2] * field[2]) / iron->strength - 1.0f;
        sum += miss * miss;
    }
    return 100.0f * sqrtf(sum / (float)background->count);
}

/** Fit all points. They never leave one by one, so a later fit is of no smaller part of the sphere than the one before. */
static void fit(background_t *background)
{
    magnetometer_points_t points = {.points = background->points, .count = (uint16_t)background->count};
    point_range_t range;
    point_range_start(&range, background->points[0]);
    for (uint32_t i = 1; i < background->count; i++) {
        (void)point_range_add(&range, background->points[i]);
    }
    memcpy(points.minimum, range.minimum, sizeof points.minimum);
    memcpy(points.maximum, range.maximum, sizeof points.maximum);
    magnetometer_fit_t found;
    magnetometer_direct(&points, &found);
    if (found.status != FIT_ELLIPSOID || found.coverage > WORST_COVERAGE) {
        return; /* not yet */
    }
    /* The fit takes points to a sphere of 1; of the field's strength, soft iron has gains that are 1 in the mean. */
    iron_t iron = {.strength = 3.0f / (found.soft_iron[0] + found.soft_iron[4] + found.soft_iron[8])};
    for (uint32_t i = 0; i < 9u; i++) {
        iron.soft_iron[i] = iron.strength * found.soft_iron[i];
        iron.hard_iron[i / 3u] = found.hard_iron[i / 3u];
    }
    iron.error_percent = error_percent(background, &iron);
    if (iron.error_percent <= WORST_ERROR_PERCENT) {
        background->iron = iron;
    } else {
        background->count = 0; /* the iron changed, or something magnetic passed by: begin anew */
    }
}

void background_take(background_t *background, const int16_t sample[3])
{
    background->samples++;
    background->changes += keep(background, sample);
    if (background->count >= POINTS_FOR_A_FIT && background->changes >= CHANGES_FOR_A_FIT) {
        background->changes = 0;
        fit(background);
    }
}
