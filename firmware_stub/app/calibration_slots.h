/**
 * @file calibration_slots.h
 * @brief The calibrations the board holds. Slot 0 is the active one; all are empty after a reset.
 */
#ifndef HILTEST_CALIBRATION_SLOTS_H
#define HILTEST_CALIBRATION_SLOTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SLOT_COUNT 8u

/** `unit = soft_iron * (counts - hard_iron)`, body frame. */
typedef struct {
    float soft_iron[9]; /**< row-major 3x3 [1/count] */
    float hard_iron[3]; /**< [counts] */
} calibration_t;

/** Fill a slot; `slot` below SLOT_COUNT. */
void slot_set(uint8_t slot, const calibration_t *calibration);

/** Empty a slot; `slot` below SLOT_COUNT. */
void slot_clear(uint8_t slot);

/** What a slot holds, NULL when it is empty; `slot` below SLOT_COUNT. */
const calibration_t *slot_get(uint8_t slot);

/** Apply a calibration to a field [counts]; `unit` gets the corrected field, of norm 1 for a good calibration. */
void calibration_apply(const calibration_t *calibration, const float field[3], float unit[3]);

#endif
