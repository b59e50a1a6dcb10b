/**
 * @file fxos8700.c
 * @brief FXOS8700CQ: accelerometer (4 g, 1/8192 g a count) and magnetometer (0.1 uT a count), both at 200 Hz in hybrid mode.
 *
 * Two sensors in one part, each with its own status and data registers, so each is read as if it were alone; setting up one sets
 * up both. The accelerometer's 14 bits come left-justified and are passed on so: the two low bits are always 0.
 */
#include "drivers.h"

#define F_SETUP 0x09u
#define XYZ_DATA_CFG 0x0Eu
#define XYZ_DATA_CFG_4_G 0x01u
#define CTRL_REG1 0x2Au
#define CTRL_REG1_STANDBY 0x00u
#define CTRL_REG1_200_HZ_LOW_NOISE_ACTIVE 0x0Du /* DR = 1: 400 Hz shared by two sensors; LNOISE; ACTIVE */
#define CTRL_REG2 0x2Bu
#define CTRL_REG2_HIGH_RESOLUTION 0x02u
#define OFF_X 0x2Fu
#define M_OFF_X_MSB 0x3Fu
#define M_CTRL_REG1 0x5Bu
#define M_CTRL_REG1_HYBRID_OVERSAMPLING_7 0x1Fu
#define M_CTRL_REG2 0x5Cu
#define M_CTRL_REG2_RESET_EACH_SAMPLE 0x00u /* magnetic reset at every sample; no jump from accelerometer to magnetometer data */

static const register_setting_t settings[] = {
    {CTRL_REG1, CTRL_REG1_STANDBY}, /* the others may change in standby only */
    {F_SETUP, 0x00},                /* no FIFO: register 0 is the data-ready status */
    {XYZ_DATA_CFG, XYZ_DATA_CFG_4_G},
    {CTRL_REG2, CTRL_REG2_HIGH_RESOLUTION},
    {OFF_X, 0x00}, /* user offsets survive a reset of this processor; see mag3110.c */
    {OFF_X + 1u, 0x00},
    {OFF_X + 2u, 0x00},
    {M_OFF_X_MSB, 0x00},
    {M_OFF_X_MSB + 1u, 0x00},
    {M_OFF_X_MSB + 2u, 0x00},
    {M_OFF_X_MSB + 3u, 0x00},
    {M_OFF_X_MSB + 4u, 0x00},
    {M_OFF_X_MSB + 5u, 0x00},
    {M_CTRL_REG1, M_CTRL_REG1_HYBRID_OVERSAMPLING_7},
    {M_CTRL_REG2, M_CTRL_REG2_RESET_EACH_SAMPLE},
    {CTRL_REG1, CTRL_REG1_200_HZ_LOW_NOISE_ACTIVE},
};

#define SETTING_COUNT (sizeof settings / sizeof settings[0])

const sensor_driver_t fxos8700_accelerometer_driver = {
    .kind = SENSOR_ACCELEROMETER,
    .who_am_i_register = 0x0D,
    .who_am_i = 0xC7,
    .status_register = 0x00,
    .temperature_register = 0x51,
    .mode_register = 0x0B, /* SYSMOD */
    .period_us = 5000,
    .settings = settings,
    .setting_count = SETTING_COUNT,
    .to_body = axes_accelerometer,
};

const sensor_driver_t fxos8700_magnetometer_driver = {
    .kind = SENSOR_MAGNETOMETER,
    .who_am_i_register = 0x0D,
    .who_am_i = 0xC7,
    .status_register = 0x32,
    .temperature_register = 0x51,
    .mode_register = 0x0B, /* SYSMOD */
    .period_us = 5000,
    .settings = settings,
    .setting_count = SETTING_COUNT,
    .to_body = axes_fxos8700_magnetometer,
};
