/* Peripherals in C: what answers the registers of a page. */
#ifndef HILTEST_DEVICES_H
#define HILTEST_DEVICES_H

#include <stddef.h>

#include "state.h"

/* A peripheral, as the first member of its own structure. */
struct device {
    uint32_t base;   /* address of its page, or of the part of one that it answers for */
    uint32_t bytes;  /* how many it answers for from there on */
    size_t size;     /* of its own structure */
    bool is_clocked; /* whether its clock gate is open; otherwise the bus refuses the access and says why */
    uint32_t (*read)(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);
    void (*write)(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value);
    void (*reset)(struct machine *machine, struct device *device); /* state after a reset of the chip; or NULL */
    uint8_t (*read_byte)(struct machine *machine, struct device *device, uint32_t offset); /* see read_by_bytes */
    void (*write_byte)(struct machine *machine, struct device *device, uint32_t offset, uint8_t value);
    uint32_t (*read_word)(struct machine *machine, struct device *device, uint32_t offset); /* see read_by_words */
    void (*destroy)(struct device *device); /* free what it owns; NULL if that is nothing */
    /* Go back to the bytes that its structure had; NULL if they are all that there is to it. */
    void (*restore)(struct device *device, const void *state);
};

/* Have a copy of a device answer for its page, from its state after a reset on; NULL if there is no room. A snapshot
 * copies its structure of so many bytes as well: what it points to never changes, or `restore` sees to it. */
struct device *add_device(struct machine *machine, const struct device *device, size_t size);
/* The device that answers for all bytes of an access, the first of them, if one does and its gate is open. */
struct device *device_at(const struct machine *machine, uint32_t address, uint32_t size);
/* The device that begins at an address, or NULL. */
struct device *device_of(const struct machine *machine, uint32_t base);

/* Access registers of a device, or those that only the bus knows if it is NULL. `refused` is set by a bus error. */
static inline uint32_t read_bus(
    struct machine *machine, struct device *device, uint32_t address, uint32_t size, bool *refused)
{
    return device ? device->read(machine, device, address - device->base, size)
                  : machine->bus.read(machine->bus.context, address, size, refused);
}

static inline void write_bus(
    struct machine *machine, struct device *device, uint32_t address, uint32_t size, uint32_t value, bool *refused)
{
    if (device)
        device->write(machine, device, address - device->base, size, value);
    else
        machine->bus.write(machine->bus.context, address, size, value, refused);
}

/* The bytes of a word register that an access at an offset has. */
uint32_t part_of_word(uint32_t word, uint32_t offset, uint32_t size);
/* `read` and `write` of devices whose registers have a byte each: they access one after the other. */
uint32_t read_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);
void write_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value);
/* `read` of devices whose registers have a word each. */
uint32_t read_by_words(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);

/* pit.c: have expiries of some channels (a bit each) let requests through. */
void hear_timers(struct machine *machine, uint32_t base, uint32_t channels);
/* dma.c: let one request of a channel through that its timer holds back. */
void let_request_through(struct machine *machine, int32_t channel);
/* dwt.c: DEMCR.TRCENA. */
void enable_trace(struct machine *machine, bool is_enabled);
/* An event has done something that the host may be waiting for: a byte for it. */
void tell_host(struct machine *machine);

#endif
