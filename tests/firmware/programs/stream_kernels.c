/* Stream calibrators over a whole cloud, in the shape of a calibrator: fed, half taken back where that can be, asked. */
#include "calibration/direct_stream.h"
#include "calibration/iterative_stream.h"

void kernel_direct_stream(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_iterative_stream(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_iterative_stream_sliced(const magnetometer_points_t *points, magnetometer_fit_t *fit);

static stream_report_t report;

void kernel_direct_stream(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static direct_stream_t state;
    direct_stream_reset(&state, false);
    for (uint16_t i = 0; i < points->count; i++) {
        (void)direct_stream_add(&state, points->points[i]);
    }
    for (uint16_t i = 0; i < points->count / 2u; i++) {
        (void)direct_stream_remove(&state, points->points[i]);
    }
    direct_stream_report(&state, &report);
    *fit = report.fit;
}

static void iterate(bool sliced, unsigned times, const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static iterative_stream_t state;
    iterative_stream_reset(&state, sliced);
    for (unsigned time = 0; time < times; time++) {
        for (uint16_t i = 0; i < points->count; i++) {
            (void)iterative_stream_add(&state, points->points[i]);
        }
    }
    iterative_stream_report(&state, &report);
    *fit = report.fit;
}

void kernel_iterative_stream(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    iterate(false, 1, points, fit);
}

/* Often enough for the solver of 7 elements, whose slices are more than the points of the cloud. */
void kernel_iterative_stream_sliced(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    iterate(true, 3, points, fit);
}
