/** @file no_store.c @brief For a board that keeps no calibration, listens to no line, and reads no gyroscope. */
#include "sensors.h"
#include "store.h"

const compass_sensor_t gyroscope = {0};

bool store_load(iron_t *iron)
{
    (void)iron;
    return false;
}

bool store_save(const iron_t *iron)
{
    (void)iron;
    return false;
}

bool typed_line_is(const char *text)
{
    (void)text;
    return false;
}
