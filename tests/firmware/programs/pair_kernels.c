/* What is no calibrator of points alone, in the shape of one: `dpi`, headings, and steps of the filter. */
#include "calibration/dpi.h"
#include "orientation/fusion.h"
#include "orientation/tilt_heading.h"

extern const int16_t cloud_accelerometer[][3];

void kernel_dpi(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_tilt_heading(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_fusion(const magnetometer_points_t *points, magnetometer_fit_t *fit);

void kernel_dpi(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static dpi_fit_t result;
    const dpi_known_t known = {.accelerometer = accelerometer_nominal};
    dpi_pairs_t pairs = {.magnetometer = points->points, .accelerometer = cloud_accelerometer, .count = points->count};
    for (int axis = 0; axis < 3; axis++) {
        pairs.minimum[axis] = points->minimum[axis];
        pairs.maximum[axis] = points->maximum[axis];
    }
    dpi_from_pairs(&pairs, &known, &result);
    *fit = result.fit;
}

static void read_pair(const magnetometer_points_t *points, uint16_t index, float gravity_g[3], float field[3])
{
    for (int axis = 0; axis < 3; axis++) {
        gravity_g[axis] = (float)cloud_accelerometer[index][axis] * ACCELEROMETER_G_PER_COUNT;
        field[axis] = (float)points->points[index][axis];
    }
}

void kernel_tilt_heading(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    for (uint16_t i = 0; i < points->count; i++) {
        float gravity[3], field[3];
        read_pair(points, i, gravity, field);
        (void)tilt_heading(gravity, field, &fit->hard_iron[0], &fit->hard_iron[1], &fit->hard_iron[2]);
    }
}

void kernel_fusion(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static fusion_t state;
    static const fusion_noise_t noise = {3e-6f, 8e-5f, 1e-3f, 0.5f};
    static const float level[4] = {0.0f, 0.0f, 0.0f, 1.0f};
    fusion_start(&state, &noise, level);
    for (uint16_t i = 0; i < points->count; i++) {
        float gravity_g[3], field[3];
        read_pair(points, i, gravity_g, field);
        (void)fusion_predict(&state, &noise, gravity_g, 0.005f); /* any rate will do */
        (void)fusion_update(&state, &noise, gravity_g, field);
    }
    fit->coverage = state.tilt_variance;
}
