/* I2C of Kinetis parts, as master: START, bytes of nine clocks, STOP, and the interrupt after each byte (K64 reference
 * manual, chapter "Inter-Integrated Circuit"). The parts on the wires are outside. As slave: the address match, bytes and
 * STOP of another master, which finds its byte at once and not nine clocks later. */
#include "devices.h"

enum { A1, F, C1, S, D, FLT = 6, REGISTERS = 16 };
enum { C1_IICEN = 0x80, C1_IICIE = 0x40, C1_MST = 0x20, C1_TX = 0x10, C1_TXAK = 0x08, C1_RSTA = 0x04, C1_DMAEN = 0x01 };
enum { S_TCF = 0x80, S_IAAS = 0x40, S_BUSY = 0x20, S_ARBL = 0x10, S_SRW = 0x04, S_IICIF = 0x02, S_RXAK = 0x01 };
enum { FLT_STOPF = 0x40, FLT_SSIE = 0x20, FLT_STARTF = 0x10, FLT_FLAGS = FLT_STOPF | FLT_STARTF };
enum { CLOCKS_A_BYTE = 9, START_CLOCKS = 1 }; /* START or repeated START, with set-up and hold times */
enum { DIVIDERS = 64 };

/* Divider by F.ICR, "I2C divider and hold values". */
static const int16_t DIVIDER[DIVIDERS] = {
    20, 22, 24, 26, 28, 30, 34, 40, 28, 32, 36, 40, 44, 48, 56, 68,
    48, 56, 64, 72, 80, 88, 104, 128, 80, 96, 112, 128, 144, 160, 192, 240,
    160, 192, 224, 256, 288, 320, 384, 480, 320, 384, 448, 512, 576, 640, 768, 960,
    640, 768, 896, 1024, 1152, 1280, 1536, 1920, 1280, 1536, 1792, 2048, 2304, 2560, 3072, 3840,
};

struct i2c {
    struct i2c_master master;
    struct event completion;
    int64_t enabled_at;   /* time of the last enabling [ps] */
    uint8_t registers[REGISTERS];
    uint8_t status, data;
    uint8_t arriving;     /* byte in transfer, which cannot be read before it is complete */
    bool is_transferring;
    bool sends_address;   /* the next byte follows a START */
    bool receives;
    bool is_acknowledged; /* byte in transfer */
    bool loses;           /* arbitration, at the end of the byte in transfer */
    bool is_addressed;    /* as slave */
    uint8_t answer;       /* byte that it sends as slave */
    bool asks_dma;        /* from the end of a byte to the next access to D */
};

static int64_t time_of(const struct machine *machine, const struct i2c_master *master)
{
    return ticks_now(machine, master->connections.time);
}

uint8_t ask_wires(struct machine *machine, const struct i2c_master *master, int32_t operation, uint8_t value)
{
    return (uint8_t)master->connections.ask(master->connections.context, operation, value, time_of(machine, master));
}

bool is_held(const struct machine *machine, const struct i2c_master *master, int32_t wire)
{
    int64_t now = time_of(machine, master);
    return master->holds[wire].begin <= now && now < master->holds[wire].end;
}

/* Return whether SDA fell while the module was enabled and SCL high, which is a START, without a later STOP. */
static bool sees_start(const struct machine *machine, const struct i2c *i2c)
{
    return is_held(machine, &i2c->master, I2C_SDA) && i2c->master.holds[I2C_SDA].begin >= i2c->enabled_at;
}

static void drive(struct machine *machine, const struct i2c *i2c)
{
    bool interrupts = i2c->status & S_IICIF && i2c->registers[C1] & C1_IICIE;
    machine_set_line(machine, i2c->master.connections.interrupt, interrupts);
    machine_set_request(machine, i2c->master.connections.request, i2c->asks_dma);
}

static void reset(struct machine *machine, struct device *device)
{
    struct i2c *i2c = (struct i2c *)device;
    cancel_event(machine, &i2c->completion);
    for (int32_t i = 0; i < REGISTERS; i++)
        i2c->registers[i] = 0;
    i2c->status = S_TCF;
    i2c->data = i2c->answer = 0;
    i2c->is_addressed = false;
    i2c->is_transferring = i2c->sends_address = i2c->receives = i2c->loses = i2c->asks_dma = false;
    i2c->enabled_at = time_of(machine, &i2c->master);
    drive(machine, i2c);
}

/* -- bytes -------------------------------------------------------------------------------------------------------- */

/* Begin a byte of so many clocks of the wire; it is delayed while SCL is held. */
static void begin_byte(struct machine *machine, struct i2c *i2c, int32_t clocks)
{
    uint8_t frequency = i2c->registers[F];
    int64_t divider = (int64_t)DIVIDER[frequency % DIVIDERS] << frequency / DIVIDERS;
    i2c->status &= (uint8_t)~S_TCF;
    i2c->is_transferring = true;
    if (!is_held(machine, &i2c->master, I2C_SCL)) {
        int64_t end = ticks_now(machine, i2c->master.connections.clock) + clocks * divider;
        plan_event_at_tick(machine, &i2c->completion, i2c->master.connections.clock, end);
    } else if (i2c->master.holds[I2C_SCL].end != NEVER) {
        plan_event_at_tick(machine, &i2c->completion, i2c->master.connections.time, i2c->master.holds[I2C_SCL].end);
    }
}

static void complete_byte(struct machine *machine, struct event *event)
{
    struct i2c *i2c = OWNER(event, struct i2c, completion);
    i2c->is_transferring = false;
    i2c->asks_dma = i2c->registers[C1] & C1_DMAEN;
    i2c->status |= S_TCF | S_IICIF;
    if (i2c->loses) {
        i2c->loses = false;
        i2c->status |= S_ARBL;
        i2c->registers[C1] &= (uint8_t)~C1_MST;
    }
    if (i2c->receives)
        i2c->data = i2c->arriving;
    else if (i2c->is_acknowledged)
        i2c->status &= (uint8_t)~S_RXAK;
    else
        i2c->status |= S_RXAK;
    drive(machine, i2c);
}

/* End the DMA request after an access to D. */
static void end_request(struct machine *machine, struct i2c *i2c)
{
    i2c->asks_dma = false;
    drive(machine, i2c);
}

/* Send a byte while SDA is held: arbitration is lost at its first bit that is 1. A byte of zeros loses no arbitration,
 * and the held wire acknowledges it. */
static void send_against_hold(struct machine *machine, struct i2c *i2c, uint8_t value)
{
    int32_t clocks = CLOCKS_A_BYTE;
    for (uint8_t rest = value; rest; rest >>= 1)
        clocks--;
    i2c->sends_address = false;
    i2c->is_acknowledged = true;
    i2c->loses = value != 0;
    begin_byte(machine, i2c, clocks);
}

static void send(struct machine *machine, struct i2c *i2c, uint8_t value)
{
    uint8_t sends = C1_MST | C1_TX;
    end_request(machine, i2c);
    if ((i2c->registers[C1] & sends) == C1_TX)
        i2c->answer = value;
    if ((i2c->registers[C1] & sends) != sends || i2c->is_transferring)
        return;
    i2c->receives = false;
    if (is_held(machine, &i2c->master, I2C_SDA)) {
        send_against_hold(machine, i2c, value);
        return;
    }
    bool is_address = i2c->sends_address;
    i2c->sends_address = false;
    i2c->is_acknowledged = ask_wires(machine, &i2c->master, is_address ? I2C_ADDRESS : I2C_WRITE, value);
    begin_byte(machine, i2c, is_address ? CLOCKS_A_BYTE + START_CLOCKS : CLOCKS_A_BYTE);
}

/* Return the byte that has arrived; as receiver, begin the next one. */
static uint8_t receive(struct machine *machine, struct i2c *i2c)
{
    uint8_t control = i2c->registers[C1];
    end_request(machine, i2c);
    if ((control & (C1_MST | C1_TX)) != C1_MST || i2c->is_transferring)
        return i2c->data;
    bool is_low = is_held(machine, &i2c->master, I2C_SDA);
    i2c->receives = true;
    i2c->arriving = is_low ? 0 : ask_wires(machine, &i2c->master, I2C_READ, (control & C1_TXAK) != 0);
    i2c->loses = is_low && control & C1_TXAK;
    begin_byte(machine, i2c, CLOCKS_A_BYTE);
    return i2c->data;
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void control(struct machine *machine, struct i2c *i2c, uint8_t value)
{
    uint8_t before = i2c->registers[C1];
    if (!(value & C1_IICEN))
        reset(machine, &i2c->master.device);
    i2c->registers[C1] = value & (uint8_t)~C1_RSTA;
    i2c->status &= (uint8_t)~S_IAAS;
    i2c->asks_dma = i2c->asks_dma && value & C1_DMAEN;
    if (value & C1_IICEN && value & C1_MST && (!(before & C1_MST) || value & C1_RSTA)) {
        i2c->status |= S_BUSY;
        i2c->sends_address = true;
    } else if (value & C1_IICEN && before & C1_MST && !(value & C1_MST)) {
        ask_wires(machine, &i2c->master, I2C_STOP, 0);
        i2c->status &= (uint8_t)~S_BUSY;
    }
    drive(machine, i2c);
}

static uint8_t read_byte(struct machine *machine, struct device *device, uint32_t offset)
{
    struct i2c *i2c = (struct i2c *)device;
    if (offset == S) {
        if (i2c->master.holds[I2C_SDA].end)
            hold_answer(machine, 0); /* BUSY changes without an event */
        return sees_start(machine, i2c) ? i2c->status | S_BUSY : i2c->status;
    }
    if (offset == D)
        return receive(machine, i2c);
    return offset < REGISTERS ? i2c->registers[offset] : 0;
}

static void write_byte(struct machine *machine, struct device *device, uint32_t offset, uint8_t value)
{
    struct i2c *i2c = (struct i2c *)device;
    if (offset == C1) {
        control(machine, i2c, value);
    } else if (offset == S) {
        i2c->status &= (uint8_t)~(value & (S_IICIF | S_ARBL));
        drive(machine, i2c);
    } else if (offset == D) {
        send(machine, i2c, value);
    } else if (offset == FLT) {
        i2c->registers[FLT] = (value & (uint8_t)~FLT_FLAGS) | (i2c->registers[FLT] & FLT_FLAGS & (uint8_t)~value);
    } else if (offset < REGISTERS) {
        i2c->registers[offset] = value;
    }
}

/* -- slave -------------------------------------------------------------------------------------------------------- */

/* Note START or STOP on the wires. */
static void note_condition(struct i2c *i2c, uint8_t flag)
{
    i2c->registers[FLT] |= flag;
    if (i2c->registers[FLT] & FLT_SSIE)
        i2c->status |= S_IICIF;
}

static bool match_address(struct i2c *i2c, uint8_t address)
{
    const uint8_t own = i2c->registers[A1] >> 1;
    i2c->is_addressed = own && (i2c->registers[C1] & (C1_IICEN | C1_MST)) == C1_IICEN && own == address >> 1;
    if (!i2c->is_addressed)
        return false;
    note_condition(i2c, FLT_STARTF);
    i2c->status = S_TCF | S_IAAS | S_BUSY | S_IICIF | (address & 1 ? S_SRW : 0);
    i2c->data = address;
    return true;
}

int32_t machine_i2c_slave(struct machine *machine, uint32_t base, int32_t operation, uint32_t value)
{
    struct i2c *i2c = (struct i2c *)device_of(machine, base);
    int32_t answer = operation == I2C_READ ? UINT8_MAX : 0; /* nobody pulls the line low */
    if (!i2c || !i2c->master.device.is_clocked)
        return answer;
    if (operation == I2C_ADDRESS) {
        answer = match_address(i2c, (uint8_t)value);
    } else if (i2c->is_addressed && operation == I2C_STOP) {
        i2c->is_addressed = false;
        i2c->status &= (uint8_t)~S_BUSY;
        note_condition(i2c, FLT_STOPF);
    } else if (i2c->is_addressed) {
        const uint8_t control = i2c->registers[C1];
        i2c->status = (i2c->status & (uint8_t)~S_RXAK) | S_TCF | S_IICIF;
        if (operation == I2C_WRITE) {
            i2c->data = (uint8_t)value;
            answer = !(control & C1_TXAK);
        } else {
            answer = control & C1_TX ? i2c->answer : UINT8_MAX;
            i2c->status |= value ? S_RXAK : 0;
        }
    }
    drive(machine, i2c);
    return answer;
}

bool machine_add_i2c(struct machine *machine, uint32_t base, struct machine_i2c connections)
{
    const struct i2c i2c = {
        .master.device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_bytes, .read_byte = read_byte, .write = write_by_bytes,
            .write_byte = write_byte, .reset = reset},
        .completion.fire = complete_byte, .master.connections = connections};
    return add_device(machine, &i2c.master.device, sizeof i2c);
}

void machine_hold_wire(struct machine *machine, uint32_t base, int32_t wire, int64_t begin, int64_t end)
{
    struct device *device = device_of(machine, base);
    if (device)
        ((struct i2c_master *)device)->holds[wire] = (struct hold){begin, end};
}
