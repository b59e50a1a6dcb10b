/**
 * @file board_sensors.h
 * @brief Which parts sit on which bus of this board. The index in the table is the sensor's id on the link.
 */
#ifndef HILTEST_BOARD_SENSORS_H
#define HILTEST_BOARD_SENSORS_H

#include "sensors/sensor.h"

#define BOARD_SENSORS_MAXIMUM 8u

/** In order of preference: at start-up the first of each kind that answers is selected. */
extern const sensor_t board_sensors[];
extern const uint8_t board_sensor_count;

#endif
