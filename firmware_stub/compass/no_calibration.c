/** @file no_calibration.c @brief No calibration by the firmware, for a magnetometer that removes its hard iron by itself. */
#include <string.h>

#include "compass.h"

void iron_remove(const iron_t *iron, const float raw[3], float field[3])
{
    (void)iron;
    memcpy(field, raw, 3u * sizeof raw[0]);
}

void background_take(background_t *background, const int16_t sample[3])
{
    (void)background;
    (void)sample;
}
