#include "sensor.h"

#include "boards/i2c.h"
#include "boards/time_base.h"

#define STATUS_XYZ_READY 0x08u
#define STATUS_XYZ_OVERWRITTEN 0x80u
#define BURST_BYTES 7u /* status, then x, y, z */
#define SAMPLE_BYTES 6u
#define FIFO_OVERFLOWED 0x80u
#define FIFO_COUNT 0x3Fu
#define STANDBY_LOOK_US 1000u
#define STANDBY_LOOKS 200u

static sensor_status_t from_bus(i2c_status_t status)
{
    switch (status) {
    case I2C_OK:
        return SENSOR_OK;
    case I2C_NO_ACKNOWLEDGE:
        return SENSOR_ABSENT;
    default:
        return SENSOR_BUS_ERROR;
    }
}

static sensor_status_t read_registers(const sensor_t *sensor, uint8_t first, uint8_t *bytes, uint8_t count)
{
    return from_bus(i2c_read(sensor->bus, sensor->address, first, bytes, count));
}

static int16_t big_endian(const uint8_t bytes[2])
{
    return (int16_t)(uint16_t)(bytes[0] << 8 | bytes[1]);
}

/** The bytes of a burst behind the status; the axes leave in the body frame. */
static inline __attribute__((always_inline)) void take_vector(const sensor_t *sensor, const uint8_t bytes[BURST_BYTES], int16_t body[3])
{
    const int16_t axes[3] = {big_endian(&bytes[1]), big_endian(&bytes[3]), big_endian(&bytes[5])};
    sensor->driver->to_body(axes, body);
}

sensor_status_t sensor_probe(const sensor_t *sensor, uint8_t *seen)
{
    *seen = 0;
    const sensor_status_t status = read_registers(sensor, sensor->driver->who_am_i_register, seen, 1);
    if (status != SENSOR_OK) {
        *seen = 0;
        return status;
    }
    return *seen == sensor->driver->who_am_i ? SENSOR_OK : SENSOR_ABSENT;
}

static sensor_status_t write_setting(const sensor_t *sensor, const register_setting_t *setting)
{
    return from_bus(i2c_write(sensor->bus, sensor->address, setting->address, &setting->value, 1));
}

static sensor_status_t wait_for_standby(const sensor_t *sensor)
{
    for (uint32_t looks = 0; looks < STANDBY_LOOKS; looks++) {
        uint8_t mode = 0;
        const sensor_status_t status = read_registers(sensor, sensor->driver->mode_register, &mode, 1);
        if (status != SENSOR_OK || mode == 0u) {
            return status;
        }
        sleep_until_us(time_us() + STANDBY_LOOK_US);
    }
    return SENSOR_TIMED_OUT;
}

static sensor_status_t write_settings(const sensor_t *sensor, const register_setting_t *settings, uint8_t count)
{
    sensor_status_t status = write_setting(sensor, &settings[0]);
    if (status == SENSOR_OK) {
        status = wait_for_standby(sensor);
    }
    for (uint8_t i = 1; i < count && status == SENSOR_OK; i++) {
        status = write_setting(sensor, &settings[i]);
    }
    return status;
}

sensor_status_t sensor_configure(const sensor_t *sensor)
{
    return write_settings(sensor, sensor->driver->settings, sensor->driver->setting_count);
}

sensor_status_t sensor_configure_fifo(const sensor_t *sensor)
{
    return write_settings(sensor, sensor->driver->fifo.settings, sensor->driver->fifo.setting_count);
}

sensor_status_t sensor_fifo_look(const sensor_t *sensor, uint8_t *held, bool *lost)
{
    uint8_t flags = 0;
    const sensor_status_t status = read_registers(sensor, sensor->driver->fifo.status_register, &flags, 1);
    *held = flags & FIFO_COUNT;
    *lost = (flags & FIFO_OVERFLOWED) != 0u;
    return status;
}

sensor_status_t sensor_fifo_read(const sensor_t *sensor, int16_t body[][3], uint8_t count)
{
    uint8_t bytes[SENSOR_FIFO_BURST * SAMPLE_BYTES];
    const sensor_status_t status =
        read_registers(sensor, sensor->driver->fifo.data_register, bytes, (uint8_t)(count * SAMPLE_BYTES));
    if (status != SENSOR_OK) {
        return status;
    }
    for (uint8_t i = 0; i < count; i++) {
        const uint8_t *sample = &bytes[i * SAMPLE_BYTES];
        const int16_t axes[3] = {big_endian(sample), big_endian(&sample[2]), big_endian(&sample[4])};
        sensor->driver->to_body(axes, body[i]);
    }
    return SENSOR_OK;
}

sensor_status_t sensor_read_if_ready(const sensor_t *sensor, sample_t *sample)
{
    uint8_t bytes[BURST_BYTES];
    const sensor_status_t status = from_bus(i2c_read_if(sensor->bus, sensor->address, sensor->driver->status_register,
                                                        STATUS_XYZ_READY, bytes, BURST_BYTES));
    if (status != SENSOR_OK) {
        return status;
    }
    if ((bytes[0] & STATUS_XYZ_READY) == 0u) {
        return SENSOR_NOT_READY;
    }
    take_vector(sensor, bytes, sample->body);
    sample->overrun = (bytes[0] & STATUS_XYZ_OVERWRITTEN) != 0u;
    return SENSOR_OK;
}

sensor_status_t sensor_read_latest(const sensor_t *sensor, int16_t body[3])
{
    uint8_t bytes[BURST_BYTES];
    const sensor_status_t status = read_registers(sensor, sensor->driver->status_register, bytes, BURST_BYTES);
    if (status == SENSOR_OK) {
        take_vector(sensor, bytes, body);
    }
    return status;
}

sensor_status_t sensor_discard(const sensor_t *sensor)
{
    int16_t dropped[3];
    return sensor_read_latest(sensor, dropped);
}

sensor_status_t sensor_die_temperature(const sensor_t *sensor, int8_t *degc)
{
    uint8_t byte = 0;
    const sensor_status_t status = read_registers(sensor, sensor->driver->temperature_register, &byte, 1);
    *degc = (int8_t)byte;
    return status;
}
