/* The I2C and time base of a board, for the drivers compiled for this machine: registers that a test fills in, and a clock that
 * moves only when it is waited on. Like the parts, a burst reads consecutive registers. */
#include <stdint.h>
#include <string.h>

#include "boards/i2c.h"
#include "boards/time_base.h"

uint8_t host_registers[256];
static uint64_t now_us;

i2c_status_t i2c_read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count)
{
    (void)bus;
    (void)address;
    memcpy(bytes, &host_registers[first_register], count);
    return I2C_OK;
}

i2c_status_t i2c_read_if(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t flags, uint8_t *bytes, uint8_t count)
{
    return i2c_read(bus, address, first_register, bytes, (host_registers[first_register] & flags) != 0u ? count : 1u);
}

i2c_status_t i2c_write(uint8_t bus, uint8_t address, uint8_t first_register, const uint8_t *bytes, uint8_t count)
{
    (void)bus;
    (void)address;
    memcpy(&host_registers[first_register], bytes, count);
    return I2C_OK;
}

uint64_t time_us(void)
{
    return now_us;
}

void sleep_until_us(uint64_t deadline_us)
{
    now_us = deadline_us;
}
