/**
 * @file board_sensors.c
 * @brief The FRDM-FXS-MULTI-B shield on I2C1 and the FRDM-K64F's own FXOS8700CQ on I2C0.
 */
#include "boards/board_sensors.h"

#include "sensors/drivers.h"

#define ON_BOARD 0u
#define SHIELD 1u

const sensor_t board_sensors[] = {
    {"MAG3110", &mag3110_driver, SHIELD, 0x0E},
    {"FXOS8700CQ accelerometer", &fxos8700_accelerometer_driver, SHIELD, 0x1E},
    {"FXOS8700CQ magnetometer", &fxos8700_magnetometer_driver, SHIELD, 0x1E},
    {"FXAS21002C", &fxas21002_driver, SHIELD, 0x20},
    {"on-board FXOS8700CQ accelerometer", &fxos8700_accelerometer_driver, ON_BOARD, 0x1D},
    {"on-board FXOS8700CQ magnetometer", &fxos8700_magnetometer_driver, ON_BOARD, 0x1D},
};

const uint8_t board_sensor_count = sizeof board_sensors / sizeof board_sensors[0];

_Static_assert(sizeof board_sensors / sizeof board_sensors[0] <= BOARD_SENSORS_MAXIMUM, "too many sensors");
