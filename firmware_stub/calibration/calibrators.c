/* The calibrators this firmware offers: one line each. The link lists them by these names. */
#include "fast_code.h"
#include "magnetometer_calibrator.h"

const calibrator_entry_t calibrators[] = {
    {"direct", magnetometer_direct},
    {"iterative", magnetometer_iterative},
};

const uint8_t calibrator_count = sizeof calibrators / sizeof calibrators[0];

FAST_CODE void magnetometer_empty(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    (void)points;
    (void)fit;
}
