/* DMA of STM32F2 and F4 parts: eight streams, each of which serves the request of one of eight channels (RM0383, chapter
 * "DMA controller"). FIFOs, bursts and priorities change no moved byte, and have no model; the lowest stream goes first.
 */
#include "devices.h"

enum { CLEAR = 0x08, FIRST = 0x10, STREAM_BYTES = 0x18, STREAMS = 8, BLOCK_BYTES = 0x400 };
enum { CR, NDTR, PAR, M0AR, M1AR, FCR, WORDS, FCR_AFTER_RESET = 0x21 };
enum { EN = 1, CIRC = 1 << 8, PINC = 1 << 9, MINC = 1 << 10, DBM = 1 << 18, CT = 1 << 19 };
enum { TO_PERIPHERAL = 1, TO_MEMORY = 2 }; /* DIR; the second is from memory to memory */
enum { TEIF = 1 << 3, HTIF = 1 << 4, TCIF = 1 << 5, INTERRUPTING = 0x3C };
enum { ITEM_CLOCKS = 4 }; /* from memory to memory: a read and a write of two clocks each */

struct dma {
    struct device device;
    struct machine_stm32_dma connections;
    struct stream {
        struct event copy; /* end of a transfer from memory to memory */
        uint32_t words[WORDS];
        uint32_t count;    /* NDTR as it was programmed */
        int32_t number;
    } streams[STREAMS];
    uint32_t flags[2];     /* LISR, HISR */
    bool is_moving;
};

/* Return the place of a stream's flags in its status register. */
static uint32_t shift_of(const struct stream *stream)
{
    static const uint8_t SHIFTS[] = {0, 6, 16, 22};
    return SHIFTS[stream->number % 4];
}

static uint32_t direction_of(const struct stream *stream) { return stream->words[CR] >> 6 & 3; }

/* DMEIE, TEIE, HTIE and TCIE are one bit below their flags. */
static void drive(struct machine *machine, const struct dma *dma, const struct stream *stream)
{
    const uint32_t flags = dma->flags[stream->number / 4] >> shift_of(stream);
    machine_set_line(
        machine, dma->connections.interrupts[stream->number], (flags & stream->words[CR] << 1 & INTERRUPTING) != 0);
}

static void set_flags(struct machine *machine, struct dma *dma, const struct stream *stream, uint32_t flags)
{
    dma->flags[stream->number / 4] |= flags << shift_of(stream);
    drive(machine, dma, stream);
}

/* Move an item, and count it. */
static void move_item(struct machine *machine, struct dma *dma, struct stream *stream)
{
    const uint32_t control = stream->words[CR], size = 1u << (control >> 11 & 3), moved = stream->count - stream->words[NDTR];
    uint32_t source = stream->words[PAR] + (control & PINC ? moved * size : 0);
    uint32_t target = stream->words[control & CT ? M1AR : M0AR] + (control & MINC ? moved * size : 0);
    uint8_t bytes[8];
    if (direction_of(stream) == TO_PERIPHERAL) {
        const uint32_t memory = target;
        target = source;
        source = memory;
    }
    if (!load_bytes(machine, source, size, bytes) || !store_bytes(machine, target, size, bytes)) {
        stream->words[CR] &= ~(uint32_t)EN;
        set_flags(machine, dma, stream, TEIF);
        return;
    }
    const uint32_t left = --stream->words[NDTR];
    if (!left && control & (CIRC | DBM)) {
        stream->words[NDTR] = stream->count;
        stream->words[CR] ^= control & DBM ? CT : 0;
    } else if (!left) {
        stream->words[CR] &= ~(uint32_t)EN;
    }
    set_flags(machine, dma, stream, (left == stream->count / 2 ? HTIF : 0) | (left ? 0 : TCIF));
}

static bool is_ready(const struct machine *machine, const struct dma *dma, const struct stream *stream)
{
    if (!(stream->words[CR] & EN) || direction_of(stream) == TO_MEMORY)
        return false;
    const int32_t source = dma->connections.sources[8 * stream->number + (int32_t)(stream->words[CR] >> 25 & 7)];
    return source >= 0 && machine->requests >> source & 1;
}

/* Move items while a stream has a request; the access of an item may end the request or raise another one. */
static void serve(struct machine *machine, struct device *device)
{
    struct dma *dma = (struct dma *)device;
    if (dma->is_moving || !device->is_clocked)
        return;
    dma->is_moving = true;
    for (int32_t n = 0; n < STREAMS;) {
        if (is_ready(machine, dma, &dma->streams[n])) {
            move_item(machine, dma, &dma->streams[n]);
            n = 0;
        } else {
            n++;
        }
    }
    dma->is_moving = false;
}

static void copy(struct machine *machine, struct event *event)
{
    struct stream *stream = OWNER(event, struct stream, copy);
    struct dma *dma = OWNER(stream - stream->number, struct dma, streams);
    while (stream->words[CR] & EN)
        move_item(machine, dma, stream);
}

static void begin(struct machine *machine, const struct dma *dma, struct stream *stream)
{
    if (!stream->words[NDTR])
        stream->words[NDTR] = stream->count;
    if (!stream->count)
        stream->words[CR] &= ~(uint32_t)EN;
    else if (direction_of(stream) == TO_MEMORY)
        plan_event_at_tick(
            machine, &stream->copy, dma->connections.clock,
            ticks_now(machine, dma->connections.clock) + (int64_t)ITEM_CLOCKS * stream->count);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct dma *dma = (struct dma *)device;
    dma->flags[0] = dma->flags[1] = 0;
    for (int32_t n = 0; n < STREAMS; n++) {
        struct stream *stream = &dma->streams[n];
        cancel_event(machine, &stream->copy);
        for (int32_t word = 0; word < WORDS; word++)
            stream->words[word] = word == FCR ? FCR_AFTER_RESET : 0;
        stream->count = 0;
        drive(machine, dma, stream);
    }
}

/* Firmware that ends a stream finds TCIF set when it has ended. */
static void control(struct machine *machine, struct dma *dma, struct stream *stream, uint32_t after)
{
    const uint32_t before = stream->words[CR];
    stream->words[CR] = after;
    if (after & ~before & EN) {
        begin(machine, dma, stream);
    } else if (before & ~after & EN) {
        cancel_event(machine, &stream->copy);
        set_flags(machine, dma, stream, TCIF);
    }
    drive(machine, dma, stream);
    serve(machine, &dma->device);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct dma *dma = (struct dma *)device;
    const uint32_t place = offset & ~3u, shift = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift;
    const uint32_t number = (place - FIRST) / STREAM_BYTES, word = (place - FIRST) % STREAM_BYTES / 4;
    if (place < FIRST) {
        if (place >= CLEAR)
            dma->flags[(place - CLEAR) / 4] &= ~(value << shift);
        for (int32_t n = 0; n < STREAMS; n++)
            drive(machine, dma, &dma->streams[n]);
    } else if (number < STREAMS) {
        struct stream *stream = &dma->streams[number];
        const uint32_t after = (stream->words[word] & ~mask) | (value << shift & mask);
        if (word == CR) {
            control(machine, dma, stream, after);
        } else if (word == FCR || !(stream->words[CR] & EN)) { /* otherwise read-only */
            stream->words[word] = word == NDTR ? after & 0xFFFF : after;
            stream->count = word == NDTR ? after & 0xFFFF : stream->count;
        }
    }
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    const struct dma *dma = (const struct dma *)device;
    (void)machine;
    if (offset < FIRST)
        return offset < CLEAR ? dma->flags[offset / 4] : 0;
    const uint32_t number = (offset - FIRST) / STREAM_BYTES;
    return number < STREAMS ? dma->streams[number].words[(offset - FIRST) % STREAM_BYTES / 4] : 0;
}

bool machine_add_stm32_dma(struct machine *machine, uint32_t base, struct machine_stm32_dma connections)
{
    struct dma dma = {
        .device = {
            .base = base, .bytes = BLOCK_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset, .take_requests = serve},
        .connections = connections};
    for (int32_t n = 0; n < STREAMS; n++) {
        dma.streams[n].number = n;
        dma.streams[n].copy.fire = copy;
    }
    struct device *device = add_device(machine, &dma.device, sizeof dma);
    machine->dma[machine->dma[0] ? 1 : 0] = device;
    return device;
}
