/**
 * @file sensors.h @brief The sensors of the compass: a row each in a table. To make it yours, write a file like magnetometer_lis3mdl.c.
 */
#ifndef COMPASS_SENSORS_H
#define COMPASS_SENSORS_H

#include <stdbool.h>

/** A sensor, in the body frame: x is forward, y right, z down. */
typedef struct {
    const char *name;
    bool (*set_up)(void);              /**< false when the part does not answer, or is another one */
    bool (*read)(float reading[3]);    /**< wait for a new sample, or read the latest; false when the part fails */
} compass_sensor_t;

extern const compass_sensor_t magnetometer;  /**< [uT]; its `read` waits for a new sample: it sets the pace, 80 to 100 a second */
extern const compass_sensor_t accelerometer; /**< [g], +1 on z when level; its `read` does not wait */
extern const compass_sensor_t gyroscope;     /**< [dps], likewise; without functions on a board that reads none */

#endif
