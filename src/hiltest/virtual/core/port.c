/* PORT and GPIO of Kinetis parts: configuration, output and level of pins, and interrupts of their edges and levels. */
#include <string.h>

#include "devices.h"

enum { PINS = 32, GPCLR = 0x80, GPCHR = 0x84, ISFR = 0xA0, PORT_BYTES = 0x100 };
enum { PDOR = 0x0, PSOR = 0x4, PCOR = 0x8, PTOR = 0xC, PDIR = 0x10, PDDR = 0x14, GPIO_BYTES = 0x40, PORTS = 5 };
enum { PCR_PULL_UP = 3, PCR_MUX_SHIFT = 8, PCR_MUX = 7, PCR_IRQC_SHIFT = 16, PCR_IRQC = 0xF, PCR_ISF = 1 << 24 };
enum { MUX_ANALOG = 0, MUX_GPIO = 1 };
enum { IRQC_LOW = 8, IRQC_RISING = 9, IRQC_FALLING = 10, IRQC_EITHER = 11, IRQC_HIGH = 12 };

struct port {
    struct device device;
    struct machine_port connections;
    struct machine_pins pins;
    uint8_t registers[PORT_BYTES]; /* registers that store writes */
    uint32_t output, direction, flags; /* PDOR, PDDR, ISFR */
    /* Pins by settings of their control registers. */
    uint32_t gpio, digital, pulled_up, on_rise, on_fall, at_low, at_high;
    uint8_t functions[PINS]; /* selected by the multiplexers */
    uint32_t unseen;         /* pins that were silent at the last update */
};

/* All ports have one page of GPIO registers. */
struct gpio {
    struct device device;
    struct port *ports[PORTS];
};

/* Compute the level of every pin, and its consequences. */
static void settle(struct machine *machine, struct port *port)
{
    struct machine_pins *pins = &port->pins;
    const uint32_t levels_before = pins->levels, low_before = pins->driven_low;
    const uint32_t driving = (port->direction & port->gpio) | pins->signals;
    const uint32_t output = (port->output & ~pins->signals) | (pins->signals & pins->signals_high);
    const uint32_t resting = (pins->outside & pins->outside_high) | (~pins->outside & port->pulled_up);
    pins->levels = ((driving & output) | (~driving & resting)) & port->digital;
    pins->driven_low = driving & ~output;
    const uint32_t visible = ~(port->unseen | pins->silent); /* the other pins have changed at an unknown time */
    const uint32_t rose = pins->levels & ~levels_before & visible, fell = levels_before & ~pins->levels & visible;
    port->unseen = pins->silent;
    port->flags |= (rose & port->on_rise) | (fell & port->on_fall);
    port->flags |= ((pins->levels & port->at_high) | (~pins->levels & port->at_low)) & port->digital;
    machine_set_line(machine, port->connections.interrupt, port->flags);
    if ((rose | fell | ((low_before ^ pins->driven_low) & visible)) & pins->watched)
        port->connections.changed(port->connections.context, rose, fell);
}

static uint32_t word_at(const struct port *port, uint32_t number)
{
    uint32_t word;
    memcpy(&word, &port->registers[4 * number], sizeof word);
    return word;
}

static uint32_t bit_if(bool condition, uint32_t pin) { return (uint32_t)condition << pin; }

/* Collect the pins' control registers into a mask for each setting. */
static void configure(struct machine *machine, struct port *port)
{
    bool has_another_function = false;
    const uint32_t interrupting_before = port->pins.interrupting;
    port->gpio = port->digital = port->pulled_up = port->on_rise = port->on_fall = port->at_low = port->at_high = 0;
    for (uint32_t pin = 0; pin < PINS; pin++) {
        const uint32_t control = word_at(port, pin), condition = control >> PCR_IRQC_SHIFT & PCR_IRQC;
        const uint8_t function = control >> PCR_MUX_SHIFT & PCR_MUX;
        port->digital |= bit_if(function != MUX_ANALOG, pin);
        port->gpio |= bit_if(function == MUX_GPIO, pin);
        port->pulled_up |= bit_if((control & PCR_PULL_UP) == PCR_PULL_UP, pin);
        port->on_rise |= bit_if(condition == IRQC_RISING || condition == IRQC_EITHER, pin);
        port->on_fall |= bit_if(condition == IRQC_FALLING || condition == IRQC_EITHER, pin);
        port->at_low |= bit_if(condition == IRQC_LOW, pin);
        port->at_high |= bit_if(condition == IRQC_HIGH, pin);
        has_another_function |= function != port->functions[pin];
        port->functions[pin] = function;
    }
    port->pins.interrupting = port->on_rise | port->on_fall | port->at_low | port->at_high;
    if (has_another_function || port->pins.interrupting != interrupting_before)
        port->connections.selected(port->connections.context);
    settle(machine, port);
}

/* -- PORT --------------------------------------------------------------------------------------------------------- */

/* Interrupt flags are in ISFR and in each pin's own register. */
static uint32_t read_port(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    const struct port *port = (const struct port *)device;
    (void)machine;
    if (offset >= PORT_BYTES)
        return 0;
    uint32_t word = (offset & ~3u) == ISFR ? port->flags : word_at(port, offset / 4);
    if (offset < GPCLR && port->flags >> offset / 4 & 1)
        word |= PCR_ISF;
    return part_of_word(word, offset, size);
}

/* Write the low halves of the control registers of 16 pins that the upper half of a value selects. */
static void write_controls(struct port *port, uint32_t first, uint32_t value)
{
    for (uint32_t pin = 0; pin < PINS / 2; pin++)
        if (value >> (PINS / 2 + pin) & 1)
            memcpy(&port->registers[4 * (first + pin)], &value, 2);
}

/* Ones clear interrupt flags. */
static void write_port(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct port *port = (struct port *)device;
    const uint32_t shift = 8 * (offset & 3), word = value << shift;
    if (offset + size > PORT_BYTES)
        return;
    switch (offset & ~3u) {
    case ISFR: port->flags &= ~word; break;
    case GPCLR: write_controls(port, 0, word); break;
    case GPCHR: write_controls(port, PINS / 2, word); break;
    default:
        if (offset < GPCLR && word & PCR_ISF) {
            port->flags &= ~(1u << offset / 4);
            value &= ~((uint32_t)PCR_ISF >> shift);
        }
        memcpy(&port->registers[offset], &value, size);
    }
    configure(machine, port);
}

/* Levels outside of the chip do not change. */
static void reset_port(struct machine *machine, struct device *device)
{
    struct port *port = (struct port *)device;
    memset(port->registers, 0, sizeof port->registers);
    memcpy(port->registers, port->connections.controls, sizeof port->connections.controls);
    port->output = port->direction = port->flags = 0;
    configure(machine, port);
}

/* -- GPIO --------------------------------------------------------------------------------------------------------- */

static struct port *port_at(struct device *device, uint32_t offset)
{
    const struct gpio *gpio = (const struct gpio *)device;
    return offset / GPIO_BYTES < PORTS ? gpio->ports[offset / GPIO_BYTES] : NULL;
}

/* Registers that set, clear and toggle read as zero. */
static uint32_t read_gpio(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    struct port *port = port_at(device, offset);
    if (!port)
        return 0;
    switch (offset % GPIO_BYTES & ~3u) {
    case PDOR: return part_of_word(port->output, offset, size);
    case PDIR:
        if (port->pins.with_signals) {
            port->connections.declare(port->connections.context);
            settle(machine, port);
        }
        return part_of_word(port->pins.levels, offset, size);
    case PDDR: return part_of_word(port->direction, offset, size);
    default: return 0;
    }
}

static void write_gpio(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct port *port = port_at(device, offset);
    const uint32_t shift = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift;
    if (!port)
        return;
    value <<= shift;
    switch (offset % GPIO_BYTES & ~3u) {
    case PDOR: port->output = (port->output & ~mask) | value; break;
    case PSOR: port->output |= value; break;
    case PCOR: port->output &= ~value; break;
    case PTOR: port->output ^= value; break;
    case PDDR: port->direction = (port->direction & ~mask) | value; break;
    default: break;
    }
    settle(machine, port);
}

/* -- the host ----------------------------------------------------------------------------------------------------- */

struct machine_pins *machine_add_port(struct machine *machine, uint32_t base, struct machine_port connections)
{
    struct port port = {
        .device = {.base = base, .bytes = PAGE_BYTES, .read = read_port, .write = write_port, .reset = reset_port},
        .connections = connections};
    for (uint32_t pin = 0; pin < PINS; pin++)
        port.functions[pin] = connections.controls[pin] >> PCR_MUX_SHIFT & PCR_MUX;
    struct device *device = add_device(machine, &port.device, sizeof port);
    return device ? &((struct port *)device)->pins : NULL;
}

bool machine_add_gpio(struct machine *machine, uint32_t base, const uint32_t ports[PORTS])
{
    struct gpio gpio = {.device = {.base = base, .bytes = PAGE_BYTES, .read = read_gpio, .write = write_gpio}};
    for (int32_t i = 0; i < PORTS; i++)
        gpio.ports[i] = (struct port *)device_of(machine, ports[i]);
    return add_device(machine, &gpio.device, sizeof gpio);
}

void machine_settle_pins(struct machine *machine, uint32_t base)
{
    settle(machine, (struct port *)device_of(machine, base));
}
