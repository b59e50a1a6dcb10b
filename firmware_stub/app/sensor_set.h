/**
 * @file sensor_set.h
 * @brief The board's sensors as the link sees them: by id, with one selected of each kind.
 */
#ifndef HILTEST_SENSOR_SET_H
#define HILTEST_SENSOR_SET_H

#include <stdbool.h>

#include "protocol/message.h"
#include "sensors/sensor.h"

/** Ask for all sensors, then select and set up the first of each kind that answers. */
void sensor_set_start(void);

/** Ask again who is there; `seen` gets the WHO_AM_I that was read, 0 for none. */
bool sensor_set_is_present(uint8_t id, uint8_t *seen);

bool sensor_set_is_selected(uint8_t id);

/** Probe, set up and select a sensor for its kind. */
status_t sensor_set_select(uint8_t id);

/** Make sure that a sensor answers and measures, selected or not. */
status_t sensor_set_prepare(uint8_t id);

/** The selected sensor of a kind, NULL when there is none. */
const sensor_t *sensor_set_selected(sensor_kind_t kind);

/** The link's word for a sensor's trouble. */
status_t status_of_sensor(sensor_status_t status);

#endif
