/**
 * @file mag3110.c
 * @brief MAG3110 magnetometer: 80 Hz, 16 samples averaged, 0.1 uT a count.
 */
#include "drivers.h"

#define CTRL_REG1 0x10u
#define CTRL_REG1_STANDBY 0x00u
#define CTRL_REG1_80_HZ_ACTIVE 0x01u /* DR = 0, OS = 0 (16), AC */
#define CTRL_REG2 0x11u
/* AUTO_MRST_EN: the sensor's own magnetisation is reset before every sample. RAW: the six user offset registers do not enter.
 * They keep their contents over a reset of this processor, so whatever an earlier firmware left there would otherwise show as
 * hard iron that nothing on this board knows of. */
#define CTRL_REG2_AUTO_RESET_RAW 0xA0u

static const register_setting_t settings[] = {
    {CTRL_REG1, CTRL_REG1_STANDBY}, /* the others may change in standby only */
    {CTRL_REG2, CTRL_REG2_AUTO_RESET_RAW},
    {CTRL_REG1, CTRL_REG1_80_HZ_ACTIVE},
};

const sensor_driver_t mag3110_driver = {
    .kind = SENSOR_MAGNETOMETER,
    .who_am_i_register = 0x07,
    .who_am_i = 0xC4,
    .status_register = 0x00,
    .temperature_register = 0x0F,
    .mode_register = 0x08, /* SYSMOD */
    .period_us = 12500,
    .settings = settings,
    .setting_count = sizeof settings / sizeof settings[0],
    .to_body = axes_mag3110,
};
