/**
 * @file drivers.h
 * @brief The parts that this firmware can read.
 */
#ifndef HILTEST_DRIVERS_H
#define HILTEST_DRIVERS_H

#include "sensor.h"

extern const sensor_driver_t mag3110_driver;
extern const sensor_driver_t fxos8700_accelerometer_driver;
extern const sensor_driver_t fxos8700_magnetometer_driver;
extern const sensor_driver_t fxas21002_driver;

#endif
