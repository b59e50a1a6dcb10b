/** @file i3g4250d.c @brief An I3G4250D on SPI, or the L3GD20 before it, with its x forward, y left and z up. */
#include "sensors.h"
#include "spi.h"

#define READ 0x80u
#define NEXT 0x40u /* the address moves on */
#define WHO_AM_I 0x0Fu
#define I3G4250D 0xD3u
#define L3GD20 0xD4u
#define CTRL_REG1 0x20u
#define WORDS_AS_A_WHOLE 0x80u /* in CTRL_REG4; the I3G4250D has no such bit */
#define OUT_X_L 0x28u
#define DPS_PER_COUNT 0.00875f /* at 245 dps */

static bool i3g4250d_set_up(void)
{
    uint8_t identity;
    if (!spi_transfer(READ | WHO_AM_I, 0, &identity, 1u) || (identity != I3G4250D && identity != L3GD20)) {
        return false;
    }
    /* CTRL_REG1 to 5: active at 105 Hz (L3GD20: 95), no high-pass filter, no interrupt, 245 dps, and 12.5 Hz by the second filter. */
    const uint8_t settings[] = {0x0F, 0x00, 0x00, identity == L3GD20 ? WORDS_AS_A_WHOLE : 0x00, 0x02};
    return spi_transfer(NEXT | CTRL_REG1, settings, 0, sizeof settings);
}

static bool i3g4250d_read(float rate_dps[3])
{
    uint8_t bytes[6];
    if (!spi_transfer(READ | NEXT | OUT_X_L, 0, bytes, sizeof bytes)) {
        return false;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int16_t counts = (int16_t)(uint16_t)(bytes[2u * axis] | bytes[2u * axis + 1u] << 8);
        rate_dps[axis] = (axis == 0u ? DPS_PER_COUNT : -DPS_PER_COUNT) * (float)counts;
    }
    return true;
}

const compass_sensor_t gyroscope = {"I3G4250D", i3g4250d_set_up, i3g4250d_read};
