/* SPI of STM32F1 to F4 parts, as master of parts whose chip selects are pins: frames of 8 and 16 bits in both directions
 * (RM0383, chapter "Serial peripheral interface"). Clock phase and polarity are not checked.
 *
 * Slave, one-way modes, CRC and I2S have no model; writes that select them are counted as accesses to a register that is
 * not modelled.
 */
#include "devices.h"

enum { CR1 = 0x00, CR2 = 0x04, SR = 0x08, DR = 0x0C, I2SCFGR = 0x1C, WORDS = 9, BLOCK_BYTES = 0x400 };
enum { MSTR = 1 << 2, SPE = 1 << 6, LSBFIRST = 1 << 7, SSI = 1 << 8, SSM = 1 << 9, DFF = 1 << 11, OTHER_MODES = 0xF400 };
enum { RXDMAEN = 1, TXDMAEN = 2, ERRIE = 1 << 5, RXNEIE = 1 << 6, TXEIE = 1 << 7 };
enum { RXNE = 1, TXE = 2, MODF = 1 << 5, OVR = 1 << 6, BSY = 1 << 7 };

struct spi {
    struct device device;
    struct machine_stm32_spi connections;
    struct event end;        /* of the frame `shifting`; planned while there is one */
    uint32_t words[WORDS];   /* without DR */
    uint32_t shifting, next, received;
    bool has_next;           /* DR has a frame behind the one that is being sent */
    bool overrun_was_read;   /* by a read of DR: one of SR clears it */
    bool fault_was_read;     /* by a read of SR: a write of CR1 clears it */
};

static void drive(struct machine *machine, const struct spi *spi)
{
    const uint32_t status = spi->words[SR / 4], control = spi->words[CR2 / 4];
    const bool asks = (status & TXE && control & TXEIE) || (status & RXNE && control & RXNEIE);
    machine_set_line(machine, spi->connections.interrupt, asks || (status & (OVR | MODF) && control & ERRIE));
    if (spi->connections.receive_request >= 0)
        machine_set_request(machine, spi->connections.receive_request, control & RXDMAEN && status & RXNE);
    if (spi->connections.send_request >= 0)
        machine_set_request(
            machine, spi->connections.send_request, spi->words[CR1 / 4] & SPE && control & TXDMAEN && status & TXE);
}

/* -- frames ------------------------------------------------------------------------------------------------------- */

static int32_t bits_of(const struct spi *spi) { return spi->words[CR1 / 4] & DFF ? 16 : 8; }

static uint32_t mirrored(uint32_t frame, int32_t bits)
{
    uint32_t result = 0;
    for (int32_t bit = 0; bit < bits; bit++)
        result |= (frame >> bit & 1) << (bits - 1 - bit);
    return result;
}

/* Exchange a frame with the parts on the wires, the highest bit first. */
static uint32_t exchange(struct machine *machine, const struct spi *spi, uint32_t frame)
{
    const int32_t bits = bits_of(spi);
    const bool is_mirrored = spi->words[CR1 / 4] & LSBFIRST;
    const int64_t time = ticks_now(machine, spi->connections.time);
    uint32_t answer = 0;
    frame = is_mirrored ? mirrored(frame, bits) : frame;
    for (int32_t shift = bits - 8; shift >= 0; shift -= 8)
        answer = answer << 8 | spi->connections.exchange(spi->connections.context, frame >> shift & 0xFF, time);
    return is_mirrored ? mirrored(answer, bits) : answer;
}

static void shift(struct machine *machine, struct spi *spi, uint32_t frame)
{
    const int32_t clock = spi->connections.clock;
    spi->shifting = frame;
    spi->words[SR / 4] |= BSY | TXE;
    plan_event_at_tick(
        machine, &spi->end, clock, ticks_now(machine, clock) + (bits_of(spi) << ((spi->words[CR1 / 4] >> 3 & 7) + 1)));
}

/* Send the frame in DR, if nothing is on the wires. */
static void go_on(struct machine *machine, struct spi *spi)
{
    if (!spi->has_next || spi->end.is_planned || (spi->words[CR1 / 4] & (SPE | MSTR)) != (SPE | MSTR))
        return;
    spi->has_next = false;
    shift(machine, spi, spi->next);
}

static void end_frame(struct machine *machine, struct event *event)
{
    struct spi *spi = OWNER(event, struct spi, end);
    const uint32_t frame = exchange(machine, spi, spi->shifting);
    if (spi->words[SR / 4] & RXNE) {
        spi->words[SR / 4] |= OVR; /* the frame is lost */
    } else {
        spi->received = frame;
        spi->words[SR / 4] |= RXNE;
    }
    spi->words[SR / 4] &= ~(uint32_t)BSY;
    go_on(machine, spi);
    drive(machine, spi);
}

static void abort_frames(struct machine *machine, struct spi *spi)
{
    cancel_event(machine, &spi->end);
    spi->has_next = false;
    spi->words[SR / 4] = (spi->words[SR / 4] & ~(uint32_t)BSY) | TXE;
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct spi *spi = (struct spi *)device;
    for (int32_t n = 0; n < WORDS; n++)
        spi->words[n] = 0;
    spi->received = 0;
    spi->overrun_was_read = spi->fault_was_read = false;
    abort_frames(machine, spi);
    drive(machine, spi);
}

static void control(struct machine *machine, struct spi *spi, uint32_t value)
{
    spi->words[CR1 / 4] = value & 0xFFFF;
    if (spi->fault_was_read)
        spi->words[SR / 4] &= ~(uint32_t)MODF;
    spi->fault_was_read = false;
    if ((value & (MSTR | SSM | SSI)) == (MSTR | SSM)) { /* NSS is low: another master */
        spi->words[CR1 / 4] &= ~(uint32_t)(MSTR | SPE);
        spi->words[SR / 4] |= MODF;
    }
    if (!(spi->words[CR1 / 4] & SPE))
        abort_frames(machine, spi);
}

static bool is_unmodelled(uint32_t offset, uint32_t value)
{
    if (offset == CR1)
        return value & OTHER_MODES || (value & SPE && (value & (MSTR | SSM)) != (MSTR | SSM));
    return offset == I2SCFGR && value;
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct spi *spi = (struct spi *)device;
    const uint32_t place = offset & ~3u, shift_bits = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift_bits;
    if (place / 4 >= WORDS)
        return;
    uint32_t *word = &spi->words[place / 4], after = (*word & ~mask) | (value << shift_bits & mask);
    if (is_unmodelled(place, after))
        machine_note_access(
            machine, (struct machine_access){
                .address = device->base + offset, .size = size, .value = value, .is_write = true, .count = 1});
    switch (place) {
    case CR1: control(machine, spi, after); break;
    case SR: break;
    case DR:
        spi->next = after & UINT32_MAX >> (32 - bits_of(spi));
        spi->has_next = true;
        spi->words[SR / 4] &= ~(uint32_t)TXE;
        break;
    default: *word = after;
    }
    go_on(machine, spi);
    drive(machine, spi);
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct spi *spi = (struct spi *)device;
    if (offset / 4 >= WORDS)
        return 0;
    uint32_t value = spi->words[offset / 4];
    if (offset == SR) {
        spi->fault_was_read = value & MODF;
        if (spi->overrun_was_read) {
            spi->words[SR / 4] &= ~(uint32_t)OVR;
            machine_load_changed(machine);
        }
        spi->overrun_was_read = false;
    } else if (offset == DR) {
        value = spi->received; /* before a request can fall and rise */
        spi->overrun_was_read = spi->words[SR / 4] & OVR;
        spi->words[SR / 4] &= ~(uint32_t)RXNE;
    }
    drive(machine, spi);
    return value;
}

bool machine_add_stm32_spi(struct machine *machine, uint32_t base, struct machine_stm32_spi connections)
{
    const struct spi spi = {
        .device = {
            .base = base, .bytes = BLOCK_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .end.fire = end_frame, .connections = connections};
    return add_device(machine, &spi.device, sizeof spi);
}
