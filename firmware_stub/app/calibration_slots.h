/**
 * @file calibration_slots.h
 * @brief The calibrations the board holds: of the magnetometer, and of the accelerometer that splits its field.
 *
 * Slot 0 is the active one. After a reset no slot has a magnetometer calibration, and all have the accelerometer's nominal one.
 */
#ifndef HILTEST_CALIBRATION_SLOTS_H
#define HILTEST_CALIBRATION_SLOTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "calibration/accelerometer_calibration.h"

#define SLOT_COUNT 16u

/** `unit = soft_iron * (counts - hard_iron)`, body frame. */
typedef struct {
    float soft_iron[9]; /**< row-major 3x3 [1/count] */
    float hard_iron[3]; /**< [counts] */
} calibration_t;

/** Give a slot a magnetometer calibration; its accelerometer's stays. `slot` below SLOT_COUNT here and below. */
void slot_set(uint8_t slot, const calibration_t *calibration);

/** Give a slot an accelerometer calibration; its magnetometer's stays. */
void slot_set_accelerometer(uint8_t slot, const accelerometer_calibration_t *calibration);

/** Take both from a slot: no magnetometer calibration, and the accelerometer's nominal one. */
void slot_clear(uint8_t slot);

/** The magnetometer calibration of a slot, NULL when it has none. */
const calibration_t *slot_get(uint8_t slot);

/** The accelerometer calibration of a slot: it always has one. */
const accelerometer_calibration_t *slot_accelerometer(uint8_t slot);

/** Apply a calibration to a field [counts]; `unit` gets the corrected field, of norm 1 for a good calibration. */
void calibration_apply(const calibration_t *calibration, const float field[3], float unit[3]);

#endif
