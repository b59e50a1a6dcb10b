/* I2C of STM32F1 to F4 parts, as master (RM0383, chapter "Inter-integrated circuit interface"): START, address, bytes of
 * nine clocks and STOP, with the stretching of SCL until firmware has answered a flag. The parts on the wires are outside.
 *
 * The slave mode, SMBus, packet errors and DMA requests have no model; writes that select them are counted as accesses to
 * a register that is not modelled.
 */
#include "devices.h"

enum { CR1 = 0x00, CR2 = 0x04, OAR1 = 0x08, DR = 0x10, SR1 = 0x14, SR2 = 0x18, CCR = 0x1C, TRISE = 0x20 };
enum { WORDS = 10, BLOCK_BYTES = 0x400, TRISE_AFTER_RESET = 2 };
enum { PE = 1, START = 1 << 8, STOP = 1 << 9, ACK = 1 << 10, POS = 1 << 11, SWRST = 1 << 15, OTHER_MODES = 0x307A };
enum { ITERREN = 1 << 8, ITEVTEN = 1 << 9, ITBUFEN = 1 << 10, DMAEN = 1 << 11, OWN_ADDRESS = 0xFE };
enum { SB = 1, ADDR = 2, BTF = 4, RXNE = 1 << 6, TXE = 1 << 7, ARLO = 1 << 9, AF = 1 << 10, ERRORS = 0xDF00 };
enum { MSL = 1, BUSY = 2, TRA = 4, FAST = 1 << 15, DUTY = 1 << 14, CCR_BITS = 0xFFF };
enum { CLOCKS_A_BYTE = 9, CLOCKS_A_CONDITION = 1 };

/* The wires: free; held by this master between bytes; or in a condition or byte, which ends with the event. */
enum phase { FREE, WAITING, STARTING, ADDRESSING, SENDING, RECEIVING, STOPPING };

struct i2c {
    struct i2c_master master;
    struct event end;   /* of the phase */
    int32_t phase;
    uint32_t words[WORDS];
    uint32_t seen;      /* SR1 at its latest read */
    uint8_t shift;      /* byte on the wires, or received behind the one in DR */
    bool has_next;      /* DR has a byte to send */
    bool holds_received;/* `shift` was received and waits for DR */
    bool is_refused;    /* an address or a byte was not acknowledged, by either side: only STOP or START go on */
    bool was_ack;       /* ACK when the byte before, or the address, ended: with POS it is for the next byte */
};

static void set_flags(struct i2c *i2c, uint32_t flags) { i2c->words[SR1 / 4] |= flags; }
static void clear_flags(struct i2c *i2c, uint32_t flags) { i2c->words[SR1 / 4] &= ~flags; }

static void drive(struct machine *machine, const struct i2c *i2c)
{
    const uint32_t enabled = i2c->words[CR2 / 4], flags = i2c->words[SR1 / 4];
    const uint32_t events = SB | ADDR | BTF | (enabled & ITBUFEN ? TXE | RXNE : 0);
    machine_set_line(machine, i2c->master.connections.interrupt, enabled & ITEVTEN && flags & events);
    machine_set_line(machine, i2c->master.connections.error_interrupt, enabled & ITERREN && flags & ERRORS);
}

/* Begin a phase of so many clocks of the wire; it is delayed while SCL is held. */
static void begin(struct machine *machine, struct i2c *i2c, int32_t phase, int32_t clocks)
{
    const uint32_t settings = i2c->words[CCR / 4];
    const int64_t scale = settings & FAST ? (settings & DUTY ? 25 : 3) : 2; /* clocks of the module for one of CCR */
    const struct hold *hold = &i2c->master.holds[I2C_SCL];
    i2c->phase = phase;
    if (!is_held(machine, &i2c->master, I2C_SCL)) {
        const int32_t clock = i2c->master.connections.clock;
        const int64_t period = scale * (settings & CCR_BITS ? settings & CCR_BITS : 1);
        plan_event_at_tick(machine, &i2c->end, clock, ticks_now(machine, clock) + clocks * period);
    } else if (hold->end != NEVER) {
        plan_event_at_tick(machine, &i2c->end, i2c->master.connections.time, hold->end);
    }
}

/* Begin a START, which waits until nobody else holds SDA. */
static void begin_start(struct machine *machine, struct i2c *i2c)
{
    const int64_t end = i2c->master.holds[I2C_SDA].end;
    clear_flags(i2c, BTF | TXE);
    if (!is_held(machine, &i2c->master, I2C_SDA))
        begin(machine, i2c, STARTING, CLOCKS_A_CONDITION);
    else if (end != NEVER)
        plan_event_at_tick(machine, &i2c->end, i2c->master.connections.time, end);
}

/* Begin the next phase, if nothing is on the wires and firmware has answered all flags that stretch SCL. */
static void go_on(struct machine *machine, struct i2c *i2c)
{
    const uint32_t control = i2c->words[CR1 / 4], flags = i2c->words[SR1 / 4];
    if (!(control & PE) || i2c->phase > WAITING)
        return;
    if (i2c->phase == FREE) {
        i2c->words[CR1 / 4] &= ~(uint32_t)STOP;
        if (control & START)
            begin_start(machine, i2c);
    } else if (flags & ADDR || (flags & SB && !(control & STOP))) {
        return;
    } else if (control & STOP) {
        clear_flags(i2c, SB | BTF | TXE);
        begin(machine, i2c, STOPPING, CLOCKS_A_CONDITION);
    } else if (control & START) {
        begin_start(machine, i2c);
    } else if (i2c->is_refused || i2c->holds_received) {
        return;
    } else if (!(i2c->words[SR2 / 4] & TRA)) {
        begin(machine, i2c, RECEIVING, CLOCKS_A_BYTE);
    } else if (i2c->has_next) {
        i2c->has_next = false;
        i2c->shift = (uint8_t)i2c->words[DR / 4];
        clear_flags(i2c, BTF);
        set_flags(i2c, TXE);
        begin(machine, i2c, SENDING, CLOCKS_A_BYTE);
    }
}

/* -- ends of phases ----------------------------------------------------------------------------------------------- */

static void release(struct i2c *i2c)
{
    i2c->phase = FREE;
    i2c->words[SR2 / 4] &= ~(uint32_t)(MSL | TRA);
    i2c->has_next = i2c->holds_received = false;
}

static void lose(struct i2c *i2c)
{
    release(i2c);
    clear_flags(i2c, BTF | TXE);
    set_flags(i2c, ARLO);
}

static void end_start(struct i2c *i2c)
{
    i2c->words[CR1 / 4] &= ~(uint32_t)START;
    i2c->words[SR2 / 4] = MSL;
    i2c->has_next = i2c->holds_received = i2c->is_refused = false;
    set_flags(i2c, SB);
}

/* A held SDA acknowledges a byte of zeros; any other byte loses the arbitration. */
static void end_sent(struct machine *machine, struct i2c *i2c, int32_t operation)
{
    const bool is_low = is_held(machine, &i2c->master, I2C_SDA);
    if (is_low && i2c->shift) {
        lose(i2c);
    } else if (!is_low && !ask_wires(machine, &i2c->master, operation, i2c->shift)) {
        i2c->is_refused = true;
        set_flags(i2c, AF);
    } else if (operation == I2C_WRITE) {
        set_flags(i2c, i2c->has_next ? 0 : BTF);
    } else {
        i2c->words[SR2 / 4] |= i2c->shift & 1 ? 0 : TRA;
        i2c->was_ack = i2c->words[CR1 / 4] & ACK;
        set_flags(i2c, ADDR);
    }
}

static void end_received(struct machine *machine, struct i2c *i2c)
{
    const bool is_ack = i2c->words[CR1 / 4] & ACK, is_low = is_held(machine, &i2c->master, I2C_SDA);
    const bool acknowledges = i2c->words[CR1 / 4] & POS ? i2c->was_ack : is_ack;
    const uint8_t byte = is_low ? 0 : ask_wires(machine, &i2c->master, I2C_READ, !acknowledges);
    i2c->was_ack = is_ack;
    i2c->is_refused = !acknowledges;
    if (i2c->words[SR1 / 4] & RXNE) {
        i2c->shift = byte;
        i2c->holds_received = true;
        set_flags(i2c, BTF);
    } else {
        i2c->words[DR / 4] = byte;
        set_flags(i2c, RXNE);
    }
    if (is_low && !acknowledges)
        lose(i2c);
}

static void end_phase(struct machine *machine, struct event *event)
{
    struct i2c *i2c = OWNER(event, struct i2c, end);
    const int32_t phase = i2c->phase;
    i2c->phase = phase == FREE ? FREE : WAITING; /* or the end of a hold, for which a START has waited */
    switch (phase) {
    case STARTING: end_start(i2c); break;
    case ADDRESSING: end_sent(machine, i2c, I2C_ADDRESS); break;
    case SENDING: end_sent(machine, i2c, I2C_WRITE); break;
    case RECEIVING: end_received(machine, i2c); break;
    case STOPPING:
        ask_wires(machine, &i2c->master, I2C_STOP, 0);
        i2c->words[CR1 / 4] &= ~(uint32_t)STOP;
        release(i2c);
        break;
    default: break;
    }
    go_on(machine, i2c);
    drive(machine, i2c);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

/* Release the wires without a STOP. */
static void disable(struct machine *machine, struct i2c *i2c)
{
    cancel_event(machine, &i2c->end);
    release(i2c);
    i2c->words[SR1 / 4] = i2c->words[SR2 / 4] = i2c->seen = 0;
    i2c->words[CR1 / 4] &= ~(uint32_t)(START | STOP | ACK | POS);
}

static void reset(struct machine *machine, struct device *device)
{
    struct i2c *i2c = (struct i2c *)device;
    for (int32_t n = 0; n < WORDS; n++)
        i2c->words[n] = 0;
    i2c->words[TRISE / 4] = TRISE_AFTER_RESET;
    i2c->is_refused = i2c->was_ack = false;
    disable(machine, i2c);
    drive(machine, i2c);
}

static void write_data(struct machine *machine, struct i2c *i2c, uint32_t value)
{
    i2c->words[DR / 4] = value & 0xFF;
    if (i2c->words[SR1 / 4] & i2c->seen & SB && i2c->phase == WAITING) {
        i2c->shift = (uint8_t)value;
        clear_flags(i2c, SB);
        begin(machine, i2c, ADDRESSING, CLOCKS_A_BYTE);
    } else if (i2c->words[SR2 / 4] & TRA) {
        i2c->has_next = true;
        clear_flags(i2c, TXE | BTF);
    }
}

static void control(struct machine *machine, struct i2c *i2c, uint32_t value)
{
    if (value & SWRST)
        reset(machine, &i2c->master.device);
    i2c->words[CR1 / 4] = value & 0xFFFF;
    if (!(value & PE))
        disable(machine, i2c);
}

static bool is_unmodelled(uint32_t offset, uint32_t value)
{
    return (offset == CR1 && value & OTHER_MODES) || (offset == CR2 && value & DMAEN)
        || (offset == OAR1 && value & OWN_ADDRESS);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct i2c *i2c = (struct i2c *)device;
    const uint32_t place = offset & ~3u, shift = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift;
    if (place / 4 >= WORDS)
        return;
    uint32_t *word = &i2c->words[place / 4], after = (*word & ~mask) | (value << shift & mask);
    if (is_unmodelled(place, after))
        machine_note_access(
            machine, (struct machine_access){
                .address = device->base + offset, .size = size, .value = value, .is_write = true, .count = 1});
    switch (place) {
    case CR1: control(machine, i2c, after); break;
    case DR: write_data(machine, i2c, after); break;
    case SR1: clear_flags(i2c, mask & ~after & ERRORS); break;
    case SR2: break;
    default: *word = after;
    }
    go_on(machine, i2c);
    drive(machine, i2c);
}

static uint32_t read_data(struct machine *machine, struct i2c *i2c)
{
    const uint32_t value = i2c->words[DR / 4];
    if (!(i2c->words[SR1 / 4] & RXNE))
        return value;
    clear_flags(i2c, RXNE | BTF);
    if (i2c->holds_received) {
        i2c->holds_received = false;
        i2c->words[DR / 4] = i2c->shift;
        set_flags(i2c, RXNE);
    }
    go_on(machine, i2c);
    return value;
}

/* Return SR2. Its read after SR1 answers ADDR. */
static uint32_t read_status(struct machine *machine, struct i2c *i2c)
{
    const bool is_low = is_held(machine, &i2c->master, I2C_SDA) || is_held(machine, &i2c->master, I2C_SCL);
    const bool is_busy = i2c->words[CR1 / 4] & PE && (i2c->phase != FREE || is_low);
    const uint32_t status = i2c->words[SR2 / 4] | (is_busy ? BUSY : 0);
    if (i2c->words[SR1 / 4] & i2c->seen & ADDR) {
        clear_flags(i2c, ADDR);
        set_flags(i2c, status & TRA && !i2c->has_next ? TXE : 0);
        go_on(machine, i2c);
    }
    return status;
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct i2c *i2c = (struct i2c *)device;
    if (offset / 4 >= WORDS)
        return 0;
    uint32_t value = i2c->words[offset / 4];
    if (offset == SR1)
        i2c->seen = value;
    else if (offset == DR)
        value = read_data(machine, i2c);
    else if (offset == SR2)
        value = read_status(machine, i2c);
    drive(machine, i2c);
    return value;
}

bool machine_add_stm32_i2c(struct machine *machine, uint32_t base, struct machine_i2c connections)
{
    const struct i2c i2c = {
        .master.device = {
            .base = base, .bytes = BLOCK_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .end.fire = end_phase, .master.connections = connections};
    return add_device(machine, &i2c.master.device, sizeof i2c);
}
