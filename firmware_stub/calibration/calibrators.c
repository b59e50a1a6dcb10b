#include "fast_code.h"
#include "magnetometer_calibrator.h"

#define CALIBRATOR_ENTRY(name, run) {name, run},

const calibrator_entry_t calibrators[] = {CALIBRATOR_TABLE(CALIBRATOR_ENTRY)};

const uint8_t calibrator_count = sizeof calibrators / sizeof calibrators[0];

FAST_CODE void magnetometer_empty(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    (void)points;
    (void)fit;
}
