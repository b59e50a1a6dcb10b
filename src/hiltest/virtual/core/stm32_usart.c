/* USART of STM32F1 to F4 parts: frames of ten bits, their flags, interrupts and requests for DMA (RM0383, chapter
 * "Universal synchronous asynchronous receiver transmitter").
 *
 * Frames with parity, nine data bits or two stop bits, and the synchronous, LIN, smart-card, infrared, half-duplex and
 * flow-control modes have no model; writes that select them are counted as accesses to a register that is not modelled.
 */
#include "devices.h"

enum { SR = 0x00, DR = 0x04, BRR = 0x08, CR1 = 0x0C, CR2 = 0x10, CR3 = 0x14, WORDS = 7, BLOCK_BYTES = 0x400 };
enum { FE = 1 << 1, ORE = 1 << 3, IDLE = 1 << 4, RXNE = 1 << 5, TC = 1 << 6, TXE = 1 << 7 };
enum { READ_CLEARS = 0x1F /* PE, FE, NF, ORE, IDLE: by a read of SR and then of DR */, WRITE_CLEARS = RXNE | TC };
enum { UE = 1 << 13, TE = 1 << 3, RE = 1 << 2, OVER8 = 1 << 15, EIE = 1, DMAR = 1 << 6, DMAT = 1 << 7 };
enum { OTHER_FRAMES = 0x1400, OTHER_STOPS = 0x7800, OTHER_MODES = 0x73E, BITS_A_BYTE = 10 };

struct usart {
    struct serial serial;
    struct event end;  /* of the byte `shifting`; planned while there is one */
    uint32_t words[WORDS];
    uint32_t seen;     /* SR at its latest read */
    uint8_t shifting, next, received;
    bool has_next;     /* DR has a byte behind the one that is being sent */
};

static void drive(struct machine *machine, const struct usart *usart)
{
    const struct machine_uart *connections = &usart->serial.connections;
    const uint32_t status = usart->words[SR / 4], control = usart->words[CR1 / 4], modes = usart->words[CR3 / 4];
    uint32_t asks = status & control & (TXE | TC | RXNE | IDLE); /* the enabling bits are at the places of the flags */
    asks |= control & RXNE ? status & ORE : 0;
    asks |= modes & EIE && modes & DMAR ? status & (FE | ORE) : 0;
    machine_set_line(machine, connections->status_interrupt, asks != 0);
    if (connections->receive_request >= 0)
        machine_set_request(machine, connections->receive_request, modes & DMAR && status & RXNE);
    if (connections->send_request >= 0)
        machine_set_request(machine, connections->send_request, modes & DMAT && status & TXE && control & TE);
}

static int64_t bit_clocks(const struct usart *usart)
{
    const uint32_t ratio = usart->words[BRR / 4] & 0xFFFF;
    return usart->words[CR1 / 4] & OVER8 ? (ratio >> 4) * 8 + (ratio & 7) : ratio;
}

static double bit_ticks(const struct serial *serial) { return (double)bit_clocks((const struct usart *)serial); }

/* -- bytes -------------------------------------------------------------------------------------------------------- */

static void shift(struct machine *machine, struct usart *usart, uint8_t byte, int64_t tick)
{
    usart->shifting = byte;
    plan_event_at_tick(machine, &usart->end, usart->serial.connections.clock, tick + BITS_A_BYTE * bit_clocks(usart));
}

static void end_byte(struct machine *machine, struct event *event)
{
    struct usart *usart = OWNER(event, struct usart, end);
    pass_to_host(machine, &usart->serial, usart->shifting);
    usart->words[SR / 4] |= usart->has_next ? TXE : TC;
    if (usart->has_next)
        shift(machine, usart, usart->next, event->tick);
    usart->has_next = false;
    drive(machine, usart);
}

static void send(struct machine *machine, struct usart *usart, uint8_t byte)
{
    usart->words[SR / 4] &= ~(usart->seen & TC);
    if ((usart->words[CR1 / 4] & (UE | TE)) != (UE | TE) || !bit_clocks(usart))
        return;
    expect_sent(machine, &usart->serial, 2); /* the byte on the line, and that in DR */
    if (!usart->end.is_planned) {
        shift(machine, usart, byte, ticks_now(machine, usart->serial.connections.clock));
        return;
    }
    usart->next = byte;
    usart->has_next = true;
    usart->words[SR / 4] &= ~(uint32_t)TXE;
}

static void arrive(struct machine *machine, struct serial *serial, uint8_t byte)
{
    struct usart *usart = (struct usart *)serial;
    const bool garbles = is_garbled(machine, serial);
    if (!serial->device.is_clocked || (usart->words[CR1 / 4] & (UE | RE)) != (UE | RE))
        return;
    if (usart->words[SR / 4] & RXNE) {
        usart->words[SR / 4] |= ORE;
    } else {
        usart->received = garbles ? byte ^ 0xFF : byte;
        usart->words[SR / 4] |= RXNE | (garbles ? FE : 0);
    }
    drive(machine, usart);
}

static void be_idle(struct machine *machine, struct serial *serial)
{
    struct usart *usart = (struct usart *)serial;
    if (serial->device.is_clocked && (usart->words[CR1 / 4] & (UE | RE)) == (UE | RE))
        usart->words[SR / 4] |= IDLE;
    drive(machine, usart);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct usart *usart = (struct usart *)device;
    cancel_event(machine, &usart->end);
    cancel_event(machine, &usart->serial.idle); /* bytes continue to arrive, at a disabled receiver */
    for (int32_t n = 0; n < WORDS; n++)
        usart->words[n] = 0;
    usart->words[SR / 4] = TXE | TC;
    usart->seen = 0;
    usart->received = 0;
    usart->has_next = false;
    drive(machine, usart);
}

static bool is_unmodelled(uint32_t offset, uint32_t value)
{
    return (offset == CR1 && value & OTHER_FRAMES) || (offset == CR2 && value & OTHER_STOPS)
        || (offset == CR3 && value & OTHER_MODES);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct usart *usart = (struct usart *)device;
    const uint32_t place = offset & ~3u, shift_bits = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift_bits;
    if (place / 4 >= WORDS)
        return;
    uint32_t *word = &usart->words[place / 4], after = (*word & ~mask) | (value << shift_bits & mask);
    if (is_unmodelled(place, after))
        machine_note_access(
            machine, (struct machine_access){
                .address = device->base + offset, .size = size, .value = value, .is_write = true, .count = 1});
    switch (place) {
    case SR: *word &= ~(mask & ~after & WRITE_CLEARS); break;
    case DR: send(machine, usart, (uint8_t)after); break;
    default: *word = after;
    }
    drive(machine, usart);
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct usart *usart = (struct usart *)device;
    if (offset == SR)
        usart->seen = usart->words[SR / 4];
    if (offset != DR)
        return offset / 4 < WORDS ? usart->words[offset / 4] : 0;
    usart->words[SR / 4] &= ~(RXNE | (usart->seen & READ_CLEARS));
    usart->seen &= ~(uint32_t)READ_CLEARS;
    const uint8_t byte = usart->received; /* before a request can fall and rise */
    drive(machine, usart);
    return byte;
}

bool machine_add_stm32_usart(struct machine *machine, uint32_t base, struct machine_uart connections)
{
    struct usart usart = {
        .serial.device = {
            .base = base, .bytes = BLOCK_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .serial.arrived = arrive, .serial.fell_silent = be_idle, .serial.bit_ticks = bit_ticks, .end.fire = end_byte};
    begin_serial(&usart.serial, connections);
    return add_device(machine, &usart.serial.device, sizeof usart);
}
