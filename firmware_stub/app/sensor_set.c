#include "sensor_set.h"

#include <stddef.h>

#include "boards/board_sensors.h"
#include "boards/time_base.h"
#include "sensors/fifo_sampler.h"

static const sensor_t *selected[SENSOR_KIND_COUNT];
static bool is_set_up[BOARD_SENSORS_MAXIMUM];

status_t status_of_sensor(sensor_status_t status)
{
    switch (status) {
    case SENSOR_OK:
        return STATUS_OK;
    case SENSOR_ABSENT:
        return STATUS_SENSOR_ABSENT;
    case SENSOR_NOT_READY:
    case SENSOR_TIMED_OUT:
        return STATUS_SENSOR_TIMEOUT;
    case SENSOR_BUS_ERROR:
        break;
    }
    return STATUS_BUS_ERROR;
}

bool sensor_set_is_present(uint8_t id, uint8_t *seen)
{
    const bool present = sensor_probe(&board_sensors[id], seen) == SENSOR_OK;
    is_set_up[id] = is_set_up[id] && present; /* one that went away comes back with its registers reset */
    return present;
}

bool sensor_set_is_selected(uint8_t id)
{
    return selected[board_sensors[id].driver->kind] == &board_sensors[id];
}

static status_t set_up(uint8_t id)
{
    uint8_t seen = 0;
    sensor_status_t status = sensor_probe(&board_sensors[id], &seen);
    fifo_sampler_forget(&board_sensors[id]);
    if (status == SENSOR_OK) {
        status = sensor_configure(&board_sensors[id]);
    }
    is_set_up[id] = status == SENSOR_OK;
    return status_of_sensor(status);
}

status_t sensor_set_select(uint8_t id)
{
    const status_t status = set_up(id);
    if (status == STATUS_OK) {
        selected[board_sensors[id].driver->kind] = &board_sensors[id];
    }
    return status;
}

status_t sensor_set_prepare(uint8_t id)
{
    return is_set_up[id] ? STATUS_OK : set_up(id);
}

const sensor_t *sensor_set_selected(sensor_kind_t kind)
{
    return selected[kind];
}

void sensor_set_start(void)
{
    sleep_until_us(SENSOR_BOOT_US);
    for (uint8_t id = 0; id < board_sensor_count; id++) {
        if (selected[board_sensors[id].driver->kind] == NULL) {
            (void)sensor_set_select(id); /* absent or broken ones show in SENSORS */
        }
    }
}
