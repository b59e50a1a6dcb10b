/**
 * @file fxas21002.c
 * @brief FXAS21002C gyroscope: 2000 dps, 1/16 dps a count, 200 Hz, low-pass at 64 Hz.
 */
#include "drivers.h"

#define F_SETUP 0x09u
#define F_SETUP_CIRCULAR 0x40u
#define CTRL_REG0 0x0Du
#define CTRL_REG0_2000_DPS 0x00u
#define CTRL_REG1 0x13u
#define CTRL_REG1_STANDBY 0x00u
#define CTRL_REG1_200_HZ_ACTIVE 0x0Au /* DR = 2; the first sample comes 60 ms and a period after standby */
#define CTRL_REG2 0x14u
#define CTRL_REG3 0x15u
#define CTRL_REG3_WRAP_TO_ONE 0x08u

static const register_setting_t settings[] = {
    {CTRL_REG1, CTRL_REG1_STANDBY}, /* the others may change in standby only; its soft reset is not used: it is not acknowledged */
    {F_SETUP, 0x00},                /* no FIFO: register 0 is the data-ready status */
    {CTRL_REG0, CTRL_REG0_2000_DPS},
    {CTRL_REG2, 0x00}, /* no interrupt pins */
    {CTRL_REG3, 0x00}, /* range not doubled */
    {CTRL_REG1, CTRL_REG1_200_HZ_ACTIVE},
};

/* The same measurement, kept in the FIFO: the oldest of 32 samples gives way to a new one, and register 6 is followed by 1. */
static const register_setting_t fifo_settings[] = {
    {CTRL_REG1, CTRL_REG1_STANDBY},
    {F_SETUP, F_SETUP_CIRCULAR},
    {CTRL_REG0, CTRL_REG0_2000_DPS},
    {CTRL_REG2, 0x00},
    {CTRL_REG3, CTRL_REG3_WRAP_TO_ONE},
    {CTRL_REG1, CTRL_REG1_200_HZ_ACTIVE},
};

const sensor_driver_t fxas21002_driver = {
    .kind = SENSOR_GYROSCOPE,
    .who_am_i_register = 0x0C,
    .who_am_i = 0xD7,
    .status_register = 0x00,
    .temperature_register = 0x12,
    .mode_register = CTRL_REG1, /* no SYSMOD here; all other bits are 0 in what standby writes */
    .period_us = 5000,
    .settings = settings,
    .setting_count = sizeof settings / sizeof settings[0],
    .fifo =
        {
            .settings = fifo_settings,
            .setting_count = sizeof fifo_settings / sizeof fifo_settings[0],
            .status_register = 0x00, /* mirrors F_STATUS while the FIFO is on */
            .data_register = 0x01,
            .start_up_us = 60000,
        },
    .to_body = axes_gyroscope,
};
