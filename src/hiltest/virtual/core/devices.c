#include "devices.h"

#include <stdlib.h>

bool add_device(struct machine *machine, struct device *device)
{
    if (machine->device_count == DEVICES) {
        free(device);
        return false;
    }
    device->is_clocked = true;
    machine->devices[machine->device_count++] = device;
    device->reset(machine, device);
    return true;
}

void forget_devices(struct machine *machine)
{
    for (int32_t i = 0; i < machine->device_count; i++) {
        if (machine->devices[i]->destroy)
            machine->devices[i]->destroy(machine->devices[i]);
        free(machine->devices[i]);
    }
    machine->device_count = 0;
}

/* The first device that has all bytes of an access, whether its gate is open or not. There are few of them, and those
 * that are used most are added first. */
static struct device *device_with(const struct machine *machine, uint32_t address, uint32_t size)
{
    for (int32_t i = 0; i < machine->device_count; i++) {
        struct device *device = machine->devices[i];
        uint32_t offset = address - device->base;
        if (offset < device->bytes && size <= device->bytes - offset)
            return device;
    }
    return NULL;
}

struct device *device_at(const struct machine *machine, uint32_t address, uint32_t size)
{
    struct device *device = device_with(machine, address, size);
    return device && device->is_clocked ? device : NULL;
}

struct device *device_of(const struct machine *machine, uint32_t base)
{
    for (int32_t i = 0; i < machine->device_count; i++)
        if (machine->devices[i]->base == base)
            return machine->devices[i];
    return NULL;
}

uint32_t part_of_word(uint32_t word, uint32_t offset, uint32_t size)
{
    return word >> 8 * (offset & 3) & UINT32_MAX >> 8 * (4 - size);
}

uint32_t read_by_bytes(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size,
    uint8_t (*read)(struct machine *machine, struct device *device, uint32_t offset))
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < size; i++)
        value |= (uint32_t)read(machine, device, offset + i) << 8 * i;
    return value;
}

void write_by_bytes(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value,
    void (*write)(struct machine *machine, struct device *device, uint32_t offset, uint8_t value))
{
    for (uint32_t i = 0; i < size; i++)
        write(machine, device, offset + i, (uint8_t)(value >> 8 * i));
}

void tell_host(struct machine *machine)
{
    machine->told_host = true;
}

void machine_set_clocked(struct machine *machine, uint32_t base, bool is_clocked)
{
    struct device *device = device_of(machine, base);
    if (device)
        device->is_clocked = is_clocked;
}

void machine_reset_device(struct machine *machine, uint32_t base)
{
    struct device *device = device_of(machine, base);
    if (device)
        device->reset(machine, device);
}

uint32_t machine_read_device(struct machine *machine, uint32_t address, uint32_t size)
{
    struct device *device = device_with(machine, address, size);
    return device ? device->read(machine, device, address - device->base, size) : 0;
}

void machine_write_device(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    struct device *device = device_with(machine, address, size);
    if (device)
        device->write(machine, device, address - device->base, size, value);
}
