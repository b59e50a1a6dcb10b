/* What is no calibrator of points alone, in the shape of one: `dpi`, headings, and updates of the filter. */
#include "calibration/dpi.h"
#include "orientation/attitude_filter.h"
#include "orientation/tilt_heading.h"

extern const int16_t cloud_accelerometer[][3];

void kernel_dpi(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_tilt_heading(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_attitude_filter(const magnetometer_points_t *points, magnetometer_fit_t *fit);

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

void kernel_attitude_filter(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static attitude_filter_t state;
    static const float no_bias_rad_s[3];
    attitude_filter_init(&state, no_bias_rad_s);
    for (uint16_t i = 0; i < points->count; i++) {
        float gravity_g[3], field[3];
        read_pair(points, i, gravity_g, field);
        (void)attitude_filter_update(&state, gravity_g, gravity_g, field, 0.05f); /* any rate will do */
    }
    attitude_filter_attitude(&state, &fit->soft_iron[0]);
}
