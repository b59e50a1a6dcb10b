/** @file shield.h @brief The bus of the sensor shield, and the set-up that its parts share. */
#ifndef COMPASS_SHIELD_H
#define COMPASS_SHIELD_H

#include "sensors/sensor.h"

#define SHIELD 1u /* I2C bus */

/** Find a part of hiltest's drivers and write its settings. */
bool shield_set_up(const sensor_t *sensor);

#endif
