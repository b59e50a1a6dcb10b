/* Peripherals in C, which handle accesses to the registers of a page. */
#ifndef HILTEST_DEVICES_H
#define HILTEST_DEVICES_H

#include <stddef.h>

#include "state.h"

/* A peripheral, as the first member of its own structure. */
struct device {
    uint32_t base;   /* address of its page, or of its part of a page */
    uint32_t bytes;  /* size of its address range */
    size_t size;     /* of its complete structure */
    bool is_clocked; /* the clock gate is open; otherwise accesses go to the bus, which refuses them with a reason */
    uint32_t (*read)(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);
    void (*write)(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value);
    void (*reset)(struct machine *machine, struct device *device); /* enter the state after a chip reset; or NULL */
    uint8_t (*read_byte)(struct machine *machine, struct device *device, uint32_t offset); /* see read_by_bytes */
    void (*write_byte)(struct machine *machine, struct device *device, uint32_t offset, uint8_t value);
    uint32_t (*read_word)(struct machine *machine, struct device *device, uint32_t offset); /* see read_by_words */
    void (*take_requests)(struct machine *machine, struct device *device); /* a request for DMA has risen */
    void (*destroy)(struct device *device); /* free its resources; NULL if it has none */
    /* Restore state outside of the structure, from the earlier bytes of the structure; NULL if there is none. */
    void (*restore)(struct device *device, const void *state);
};

/* Add a copy of a device to the machine, and reset it; NULL if out of memory. A snapshot copies the whole structure, so
 * its pointers must never change, or `restore` must update them. */
struct device *add_device(struct machine *machine, const struct device *device, size_t size);
/* Return the first device that has all bytes of an access; NULL if there is none, or if its clock gate is closed. */
struct device *device_at(const struct machine *machine, uint32_t address, uint32_t size);
/* Return the device whose first address is `base`, or NULL. */
struct device *device_of(const struct machine *machine, uint32_t base);

/* Access a register of a device; with NULL, a register on the bus. A bus error sets `refused`. */
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

/* Return the part of a word register that an access at an offset covers. */
uint32_t part_of_word(uint32_t word, uint32_t offset, uint32_t size);
/* `read` and `write` of devices with registers of one byte, which are accessed one after the other. */
uint32_t read_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);
void write_by_bytes(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value);
/* `read` of devices with registers of one word. */
uint32_t read_by_words(struct machine *machine, struct device *device, uint32_t offset, uint32_t size);

/* An I2C master, as the first member of its own structure. */
struct i2c_master {
    struct device device;
    struct machine_i2c connections;
    struct hold {
        int64_t begin, end;
    } holds[2]; /* by enum i2c_wire: time for which a wire is pulled low [ps]; both are 0 if it is not */
};
/* i2c.c: let the parts on the wires do an operation; return whether a wire is pulled low. */
uint8_t ask_wires(struct machine *machine, const struct i2c_master *master, int32_t operation, uint8_t value);
bool is_held(const struct machine *machine, const struct i2c_master *master, int32_t wire);

/* A UART with the far end of its wires, as the first member of its own structure (serial.c). */
struct serial {
    struct device device;
    struct machine_uart connections;
    struct queue {
        uint8_t *bytes;
        int32_t begin, count, capacity;
    } incoming, sent;            /* bytes from the host, and unfetched bytes for it */
    bool has_lost;               /* sent bytes were lost */
    int32_t expected_count, expected_byte; /* see machine_uart_expect */
    double line_baud;            /* at the far end of the wires */
    int64_t line_byte_ps;
    struct event arrival;        /* of the first byte of `incoming` */
    struct event idle;           /* end of a byte's time of silence on the line */
    int64_t heard_at, heard_awake; /* cycles, and cycles of the thread alone, at the last byte from the host */
    bool is_unanswered;          /* nothing was sent since then */
    struct machine_answer answer;
    void (*arrived)(struct machine *machine, struct serial *serial, uint8_t byte);
    void (*fell_silent)(struct machine *machine, struct serial *serial);
    double (*bit_ticks)(const struct serial *serial); /* ticks of the module's clock for a bit; 0 if none is set up */
};
void begin_serial(struct serial *serial, struct machine_uart connections);
/* Note that the board has a byte to send, so that `count` bytes may soon wait for the host. */
void expect_sent(struct machine *machine, struct serial *serial, int32_t count);
/* Pass a byte to the host, whose far end garbles it at another rate. */
void pass_to_host(struct machine *machine, struct serial *serial, uint8_t byte);
/* Return whether the board's rate is so far from the line's that bytes are garbled. */
bool is_garbled(const struct machine *machine, const struct serial *serial);

/* dma.c: access memory or a register, as another master; false if it has no answer. */
bool load_bytes(struct machine *machine, uint32_t address, uint32_t size, uint8_t *bytes);
bool store_bytes(struct machine *machine, uint32_t address, uint32_t size, const uint8_t *bytes);

/* pit.c: select the channels, one bit each, whose expiries trigger DMA channels. */
void select_triggers(struct machine *machine, uint32_t base, uint32_t channels);
/* dma.c: pass one request of a channel that is gated by its timer. */
void trigger_request(struct machine *machine, int32_t channel);
/* dwt.c: DEMCR.TRCENA. */
void enable_trace(struct machine *machine, bool is_enabled);
/* Record an event that the host may wait for: a byte for the host. */
void notify_host(struct machine *machine);

#endif
