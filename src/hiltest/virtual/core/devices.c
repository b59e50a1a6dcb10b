#include "devices.h"

#include <stdlib.h>
#include <string.h>

struct device *add_device(struct machine *machine, const struct device *device, size_t size)
{
    struct device *copy = machine->device_count < DEVICES ? malloc(size) : NULL;
    if (!copy)
        return NULL;
    memcpy(copy, device, size);
    copy->is_clocked = true;
    copy->size = size;
    for (uint32_t page = 0; page < DEVICE_PAGES; page++) {
        const uint32_t begin = DEVICE_BASE + page * PAGE_BYTES;
        if (!machine->first_on_page[page] && begin < copy->base + copy->bytes && copy->base < begin + PAGE_BYTES)
            machine->first_on_page[page] = (uint8_t)(machine->device_count + 1);
    }
    machine->devices[machine->device_count++] = copy;
    if (copy->reset)
        copy->reset(machine, copy);
    return copy;
}

void forget_devices(struct machine *machine)
{
    for (int32_t i = 0; i < machine->device_count; i++) {
        if (machine->devices[i]->destroy)
            machine->devices[i]->destroy(machine->devices[i]);
        free(machine->devices[i]);
    }
    machine->device_count = 0;
    memset(machine->first_on_page, 0, sizeof machine->first_on_page);
}

/* Return the first device that has all bytes of an access, with any state of its gate. */
static struct device *device_with(const struct machine *machine, uint32_t address, uint32_t size)
{
    const uint32_t page = (address - DEVICE_BASE) / PAGE_BYTES;
    int32_t i = page < DEVICE_PAGES ? machine->first_on_page[page] - 1 : 0;
    for (; i >= 0 && i < machine->device_count; i++) {
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

uint32_t read_by_words(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    return part_of_word(device->read_word(machine, device, offset & ~3u), offset, size);
}

uint32_t read_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < size; i++)
        value |= (uint32_t)device->read_byte(machine, device, offset + i) << 8 * i;
    return value;
}

void write_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    for (uint32_t i = 0; i < size; i++)
        device->write_byte(machine, device, offset + i, (uint8_t)(value >> 8 * i));
}

void notify_host(struct machine *machine) { machine->host_notified = true; }

void machine_set_clocked(struct machine *machine, uint32_t base, bool is_clocked)
{
    struct device *device = device_of(machine, base);
    if (device)
        device->is_clocked = is_clocked;
}

void machine_reset_device(struct machine *machine, uint32_t base)
{
    struct device *device = device_of(machine, base);
    if (device && device->reset)
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

/* -- snapshots ---------------------------------------------------------------------------------------------------- */

/* Peripherals at some moment: their common state, and the structure of each, one after the other. */
struct device_states {
    struct calendar calendar;
    uint64_t requests;
    uint32_t answers[ANSWERS];
    int64_t oldest_answer;
    uint8_t structures[];
};

struct device_states *copy_devices(const struct machine *machine)
{
    size_t size = 0;
    for (int32_t i = 0; i < machine->device_count; i++)
        size += machine->devices[i]->size;
    struct device_states *states = malloc(sizeof *states + size);
    if (!states)
        return NULL;
    states->calendar = machine->calendar;
    states->requests = machine->requests;
    memcpy(states->answers, machine->answers, sizeof states->answers);
    states->oldest_answer = machine->oldest_answer;
    uint8_t *structure = states->structures;
    for (int32_t i = 0; i < machine->device_count; i++) {
        memcpy(structure, machine->devices[i], machine->devices[i]->size);
        structure += machine->devices[i]->size;
    }
    return states;
}

/* Events are members of their peripherals: the queue's pointers to them are valid as long as the machine. */
void restore_devices(struct machine *machine, const struct device_states *states)
{
    machine->calendar = states->calendar;
    machine->requests = states->requests;
    memcpy(machine->answers, states->answers, sizeof machine->answers);
    machine->oldest_answer = states->oldest_answer;
    const uint8_t *structure = states->structures;
    for (int32_t i = 0; i < machine->device_count; i++) {
        struct device *device = machine->devices[i];
        const size_t size = device->size;
        if (device->restore)
            device->restore(device, structure);
        else
            memcpy(device, structure, size);
        structure += size;
    }
}
