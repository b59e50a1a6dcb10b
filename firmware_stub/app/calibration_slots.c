#include "calibration_slots.h"

static struct {
    calibration_t calibration;
    accelerometer_calibration_t accelerometer;
    bool filled;
    bool has_accelerometer; /* else it is the nominal one: so a slot that was never touched needs no start-up code */
} slots[SLOT_COUNT];

void slot_set(uint8_t slot, const calibration_t *calibration)
{
    slots[slot].calibration = *calibration;
    slots[slot].filled = true;
}

void slot_set_accelerometer(uint8_t slot, const accelerometer_calibration_t *calibration)
{
    slots[slot].accelerometer = *calibration;
    slots[slot].has_accelerometer = true;
}

void slot_clear(uint8_t slot)
{
    slots[slot].filled = false;
    slots[slot].has_accelerometer = false;
}

const calibration_t *slot_get(uint8_t slot)
{
    return slots[slot].filled ? &slots[slot].calibration : NULL;
}

const accelerometer_calibration_t *slot_accelerometer(uint8_t slot)
{
    return slots[slot].has_accelerometer ? &slots[slot].accelerometer : &accelerometer_nominal;
}

void calibration_apply(const calibration_t *calibration, const float field[3], float unit[3])
{
    const float *row = calibration->soft_iron;
    const float x = field[0] - calibration->hard_iron[0];
    const float y = field[1] - calibration->hard_iron[1];
    const float z = field[2] - calibration->hard_iron[2];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        unit[axis] = row[0] * x + row[1] * y + row[2] * z;
        row += 3;
    }
}
