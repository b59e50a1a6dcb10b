/* eDMA and DMAMUX of Kinetis parts: sixteen channels that transfer data in parallel with the processor.
 *
 * Minor loops are carried out one after the other without interruption. Their data reaches memory and peripherals at
 * the end of the time that it takes, in pieces if it is long.
 */
#include <string.h>

#include "devices.h"

enum { CHANNELS = 16, ALL_CHANNELS = (1 << CHANNELS) - 1, ERROR_LINE = CHANNELS };
enum { CR = 0x0, ES = 0x4, ERQ = 0xC, EEI = 0x14, CEEI = 0x18, SEEI, CERQ, SERQ, CDNE, SSRT, CERR, CINT };
enum { INT = 0x24, ERR = 0x2C, HRS = 0x34, DCHPRI = 0x100, DESCRIPTORS = 0x1000, REGISTER_BYTES = 2 * PAGE_BYTES };
enum { CR_ERCA = 1 << 2, CR_HOE = 1 << 4, CR_HALT = 1 << 5, CR_EMLM = 1 << 7, CR_BITS = 0xFE }; /* no cancelling */
enum { ES_DBE = 1, ES_SBE = 2, ES_SGE = 4, ES_NCE = 8, ES_DOE = 16, ES_DAE = 32, ES_SOE = 64, ES_SAE = 128 };
enum { ES_CPE = 1 << 14, NO_COMMAND = 0x80, COMMAND_ALL = 0x40, DCHPRI_BITS = 0xCF, PRIORITY = 0xF };
enum { CSR_START = 1, CSR_INTMAJOR = 2, CSR_INTHALF = 4, CSR_DREQ = 8, CSR_ESG = 16, CSR_MAJORELINK = 32 };
enum { CSR_ACTIVE = 64, CSR_DONE = 128, CSR_PLACE = 0x1C, CSR_BYTES = 2, ITER_ELINK = 1 << 15 };
enum { CHCFG_ENBL = 0x80, CHCFG_TRIG = 0x40, CHCFG_SOURCE = 0x3F, ALWAYS_ON = 58, HOLDABLE_CHANNELS = 4 };
static const uint32_t ES_VLD = 1u << 31, NBYTES_SMLOE = 1u << 31, NBYTES_DMLOE = 1u << 30;

enum { BUS_BYTES = 4, MOST_BYTES = 32, ACCESSES = 256 /* at most at one event */ };
/* Core clocks, as in the manual's section on performance: for the beginning and the end of a minor loop, and for an
 * access of up to four bytes to memory, for reading a peripheral, and for writing one. */
enum { BEGIN_CYCLES = 4, END_CYCLES = 3, MEMORY_CYCLES = 1, READ_CYCLES = 3, WRITE_CYCLES = 4 };

/* A transfer control descriptor, with the layout of registers and memory. */
struct descriptor {
    uint32_t source;
    int16_t source_step;
    uint16_t attributes;
    uint32_t bytes;
    int32_t last_source;
    uint32_t destination;
    int16_t destination_step;
    uint16_t loops;
    int32_t last_destination;
    uint16_t control, first_loops;
};

struct dma {
    struct device device;
    struct machine_dma connections;
    struct event event; /* end of the current piece of the minor loop, or of its refusal */
    bool is_busy;
    uint32_t control, error, enabled, error_enabled, interrupts, errors; /* CR, ES, ERQ, EEI, INT, ERR */
    uint32_t driven;    /* levels of the interrupt lines, a bit each */
    uint8_t priorities[CHANNELS];
    struct descriptor descriptors[CHANNELS];
    uint32_t channel;   /* channel of the current or the last minor loop */
    struct descriptor active;
    bool has_offset;    /* NBYTES has an offset of minor loops */
    uint32_t refusal;   /* bits of ES, or 0 */
    int64_t remaining, moving; /* bytes of the minor loop; bytes that the event moves */
    uint8_t sources[CHANNELS]; /* CHCFG of the DMAMUX */
    uint32_t triggered; /* channels that are gated by their timer, and have a request to pass */
};

struct multiplexer {
    struct device device;
    struct dma *dma;
};

/* -- requests ----------------------------------------------------------------------------------------------------- */

static bool is_asked(const struct machine *machine, const struct dma *dma, uint32_t channel)
{
    const uint32_t source = dma->sources[channel] & CHCFG_SOURCE;
    return dma->sources[channel] & CHCFG_ENBL && (source >= ALWAYS_ON || machine->requests >> source & 1);
}

static bool is_requested(const struct machine *machine, const struct dma *dma, uint32_t channel)
{
    const bool is_held = channel < HOLDABLE_CHANNELS && dma->sources[channel] & CHCFG_TRIG;
    return is_asked(machine, dma, channel) && (!is_held || dma->triggered >> channel & 1);
}

/* Return whether a channel precedes one that has a lower number. */
static bool is_before(const struct dma *dma, uint32_t channel, uint32_t lower)
{
    if (dma->control & CR_ERCA) /* from high numbers to low, after the previous channel */
        return channel < dma->channel || lower >= dma->channel;
    return (dma->priorities[channel] & PRIORITY) > (dma->priorities[lower] & PRIORITY);
}

/* Return the next channel, or CHANNELS. */
static uint32_t next_channel(const struct machine *machine, const struct dma *dma)
{
    uint32_t next = CHANNELS;
    for (uint32_t channel = 0; channel < CHANNELS; channel++) {
        const bool is_started = dma->descriptors[channel].control & CSR_START;
        const bool is_wanted = is_started || (dma->enabled >> channel & 1 && is_requested(machine, dma, channel));
        if (is_wanted && (next == CHANNELS || is_before(dma, channel, next)))
            next = channel;
    }
    return next;
}

static void drive(struct machine *machine, struct dma *dma)
{
    const uint32_t levels = dma->interrupts | (uint32_t)((dma->errors & dma->error_enabled) != 0) << ERROR_LINE;
    for (int32_t line = 0; line <= ERROR_LINE; line++)
        if ((levels ^ dma->driven) >> line & 1)
            machine_set_line(machine, dma->connections.interrupts[line], levels >> line & 1);
    dma->driven = levels;
}

/* -- descriptors -------------------------------------------------------------------------------------------------- */

/* Bytes of one access by its code; 0 for an invalid code. */
static uint32_t access_bytes(int32_t code)
{
    static const uint8_t bytes[8] = {1, 2, 4, 0, 16, 32, 0, 0};
    return bytes[code & 7];
}

static uint32_t source_bytes(const struct descriptor *descriptor) { return access_bytes(descriptor->attributes >> 8); }

static uint32_t destination_bytes(const struct descriptor *descriptor) { return access_bytes(descriptor->attributes); }

static bool has_offset(const struct dma *dma, const struct descriptor *descriptor)
{
    return dma->has_offset && descriptor->bytes & (NBYTES_SMLOE | NBYTES_DMLOE);
}

static int64_t minor_bytes(const struct dma *dma, const struct descriptor *descriptor)
{
    if (!dma->has_offset)
        return descriptor->bytes ? descriptor->bytes : INT64_C(1) << 32;
    return descriptor->bytes & (has_offset(dma, descriptor) ? 0x3FF : NBYTES_DMLOE - 1);
}

/* Return the minor loops of CITER or BITER. */
static int32_t loops_of(uint16_t iterations) { return iterations & (iterations & ITER_ELINK ? 0x1FF : ITER_ELINK - 1); }

/* Return bits of ES for errors that prevent the transfer. */
static uint32_t error_of(const struct dma *dma, const struct descriptor *descriptor)
{
    const int32_t source = (int32_t)source_bytes(descriptor), destination = (int32_t)destination_bytes(descriptor);
    const int64_t bytes = minor_bytes(dma, descriptor);
    uint32_t error = 0;
    if (!source || descriptor->source % (uint32_t)source)
        error |= ES_SAE;
    if (!source || descriptor->source_step % source)
        error |= ES_SOE;
    if (!destination || descriptor->destination % (uint32_t)destination)
        error |= ES_DAE;
    if (!destination || descriptor->destination_step % destination)
        error |= ES_DOE;
    if (!source || !destination || bytes % source || bytes % destination || !bytes || !loops_of(descriptor->loops)
        || (descriptor->loops ^ descriptor->first_loops) & ITER_ELINK)
        error |= ES_NCE;
    return error;
}

static bool has_equal_priorities(const struct dma *dma)
{
    uint32_t levels = 0;
    for (int32_t channel = 0; channel < CHANNELS; channel++)
        levels |= 1u << (dma->priorities[channel] & PRIORITY);
    return levels != ALL_CHANNELS;
}

/* Add an offset; with a modulo only the lowest bits change. */
static uint32_t stepped(uint32_t address, int16_t offset, int32_t modulo)
{
    const uint32_t mask = modulo ? (1u << modulo) - 1 : UINT32_MAX;
    return (address & ~mask) | ((address + (uint32_t)offset) & mask);
}

/* -- one minor loop ----------------------------------------------------------------------------------------------- */

static bool is_peripheral(uint32_t address) { return address - DEVICE_BASE < DEVICE_BYTES; }

static int64_t words_of(uint32_t bytes) { return bytes > BUS_BYTES ? bytes / BUS_BYTES : 1; }

/* Plan the transfer of the next piece, at the end of its duration, which begins at a cycle. */
static void plan_piece(struct machine *machine, struct dma *dma, int64_t cycle)
{
    const struct descriptor *active = &dma->active;
    const uint32_t source = source_bytes(active), destination = destination_bytes(active);
    const int64_t most = (int64_t)(source > destination ? source : destination) * ACCESSES;
    dma->moving = dma->remaining < most ? dma->remaining : most;
    cycle += dma->moving / source * words_of(source) * (is_peripheral(active->source) ? READ_CYCLES : MEMORY_CYCLES);
    cycle += dma->moving / destination * words_of(destination)
        * (is_peripheral(active->destination) ? WRITE_CYCLES : MEMORY_CYCLES);
    plan_event(machine, &dma->event, cycle + (dma->moving == dma->remaining ? END_CYCLES : 0));
}

/* Begin a minor loop at a cycle, if one is requested. */
static void begin(struct machine *machine, struct dma *dma, int64_t cycle)
{
    const uint32_t channel = dma->control & CR_HALT ? CHANNELS : next_channel(machine, dma);
    dma->is_busy = channel < CHANNELS;
    if (!dma->is_busy)
        return;
    struct descriptor *descriptor = &dma->descriptors[channel];
    descriptor->control = (uint16_t)((descriptor->control & ~(CSR_START | CSR_DONE)) | CSR_ACTIVE);
    dma->triggered &= ~(1u << channel);
    dma->channel = channel;
    dma->active = *descriptor;
    dma->has_offset = dma->control & CR_EMLM;
    dma->remaining = minor_bytes(dma, descriptor);
    dma->refusal = !(dma->control & CR_ERCA) && has_equal_priorities(dma) ? ES_CPE : error_of(dma, descriptor);
    if (dma->refusal)
        plan_event(machine, &dma->event, cycle + BEGIN_CYCLES + END_CYCLES);
    else
        plan_piece(machine, dma, cycle + BEGIN_CYCLES);
}

static void look(struct machine *machine, struct dma *dma)
{
    if (!dma->is_busy)
        begin(machine, dma, machine->core.cycles);
}

bool load_bytes(struct machine *machine, uint32_t address, uint32_t size, uint8_t *bytes)
{
    bool refused = false;
    if (!is_peripheral(address))
        return machine_read(machine, address, size, bytes);
    const uint32_t width = size < BUS_BYTES ? size : BUS_BYTES;
    for (uint32_t offset = 0; offset < size && !refused; offset += width) {
        struct device *device = device_at(machine, address + offset, width);
        const uint32_t value = read_bus(machine, device, address + offset, width, &refused);
        memcpy(bytes + offset, &value, width);
    }
    return !refused;
}

bool store_bytes(struct machine *machine, uint32_t address, uint32_t size, const uint8_t *bytes)
{
    bool refused = !is_peripheral(address);
    if (machine_holds_stack(machine, address, size))
        return machine_write(machine, address, size, bytes);
    const uint32_t width = size < BUS_BYTES ? size : BUS_BYTES;
    for (uint32_t offset = 0; offset < size && !refused; offset += width) {
        struct device *device = device_at(machine, address + offset, width);
        uint32_t value = 0;
        memcpy(&value, bytes + offset, width);
        write_bus(machine, device, address + offset, width, value, &refused);
    }
    return !refused;
}

/* Return 0, or the bit of ES for an access without an answer. */
static uint32_t move_piece(struct machine *machine, const struct dma *dma, struct descriptor *active)
{
    const uint32_t source = source_bytes(active), destination = destination_bytes(active);
    const uint32_t together = source > destination ? source : destination;
    uint8_t bytes[MOST_BYTES];
    for (int64_t moved = 0; moved < dma->moving; moved += together) {
        for (uint32_t first = 0; first < together; first += source) {
            if (!load_bytes(machine, active->source, source, bytes + first))
                return ES_SBE;
            active->source = stepped(active->source, active->source_step, active->attributes >> 11);
        }
        for (uint32_t first = 0; first < together; first += destination) {
            if (!store_bytes(machine, active->destination, destination, bytes + first))
                return ES_DBE;
            active->destination =
                stepped(active->destination, active->destination_step, active->attributes >> 3 & 0x1F);
        }
    }
    return 0;
}

/* -- end of a minor loop ------------------------------------------------------------------------------------------ */

static void fail(struct dma *dma, uint32_t error)
{
    dma->error = dma->channel << 8 | error;
    dma->errors |= 1u << dma->channel;
    if (dma->control & CR_HOE)
        dma->control |= CR_HALT;
}

/* Load the next descriptor from memory. */
static void gather(struct machine *machine, struct dma *dma)
{
    const uint32_t address = (uint32_t)dma->active.last_destination;
    struct descriptor following;
    if (address % sizeof following)
        fail(dma, ES_SGE);
    else if (!load_bytes(machine, address, sizeof following, (uint8_t *)&following))
        fail(dma, ES_SBE);
    else
        dma->active = following;
}

/* Adjust the addresses, and restart the count. */
static void end_major_loop(struct machine *machine, struct dma *dma)
{
    struct descriptor *active = &dma->active;
    const uint16_t control = active->control;
    active->source += (uint32_t)active->last_source;
    if (!(control & CSR_ESG))
        active->destination += (uint32_t)active->last_destination;
    active->loops = active->first_loops;
    active->control |= CSR_DONE;
    if (control & CSR_INTMAJOR)
        dma->interrupts |= 1u << dma->channel;
    if (control & CSR_DREQ)
        dma->enabled &= ~(1u << dma->channel);
    if (control & CSR_ESG)
        gather(machine, dma);
}

/* Add the offset of minor loops: 20 bits with a sign. */
static void add_offset(struct descriptor *active)
{
    const int32_t offset = (int32_t)(active->bytes << 2) >> 12;
    active->source += active->bytes & NBYTES_SMLOE ? (uint32_t)offset : 0;
    active->destination += active->bytes & NBYTES_DMLOE ? (uint32_t)offset : 0;
}

static void end_minor_loop(struct machine *machine, struct dma *dma)
{
    struct descriptor *active = &dma->active, *registers = &dma->descriptors[dma->channel];
    const uint16_t iterations = active->loops--, control = active->control;
    const bool is_last = loops_of(iterations) == 1;
    const bool has_link = is_last ? control & CSR_MAJORELINK : iterations & ITER_ELINK;
    const uint32_t link = (is_last ? control >> 8 : iterations >> 9) & 0xF;
    if (!is_last && has_offset(dma, active))
        add_offset(active);
    if (is_last)
        end_major_loop(machine, dma);
    else if (control & CSR_INTHALF && loops_of(active->loops) == loops_of(active->first_loops) >> 1)
        dma->interrupts |= 1u << dma->channel;
    const int32_t started = registers->control & CSR_START; /* set while the loop ran */
    *registers = *active;
    registers->control = (uint16_t)((active->control & ~CSR_ACTIVE) | started);
    if (has_link)
        dma->descriptors[link].control |= CSR_START;
}

static void go_on(struct machine *machine, struct event *event)
{
    struct dma *dma = OWNER(event, struct dma, event);
    struct descriptor *registers = &dma->descriptors[dma->channel];
    const int64_t cycle = machine->calendar.time;
    uint32_t error = dma->refusal;
    if (!error) {
        error = move_piece(machine, dma, &dma->active);
        dma->remaining -= dma->moving;
        if (error)
            *registers = dma->active;
    }
    if (error) {
        registers->control &= (uint16_t)~CSR_ACTIVE;
        fail(dma, error);
    } else if (dma->remaining) {
        plan_piece(machine, dma, cycle);
        return;
    } else {
        end_minor_loop(machine, dma);
    }
    drive(machine, dma);
    begin(machine, dma, cycle);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static uint32_t *word_at(struct dma *dma, uint32_t offset)
{
    switch (offset) {
    case ERQ: return &dma->enabled;
    case EEI: return &dma->error_enabled;
    case INT: return &dma->interrupts;
    case ERR: return &dma->errors;
    default: return NULL;
    }
}

static uint32_t read_word(const struct machine *machine, struct dma *dma, uint32_t offset)
{
    const uint32_t *word = word_at(dma, offset);
    uint32_t requested = 0;
    switch (offset) {
    case CR: return dma->control;
    case ES: return dma->error | (dma->errors ? ES_VLD : 0);
    case HRS:
        for (uint32_t channel = 0; channel < CHANNELS; channel++)
            requested |= (uint32_t)is_requested(machine, dma, channel) << channel;
        return requested;
    default: return word ? *word : 0;
    }
}

static uint8_t read_priority(struct machine *machine, struct device *device, uint32_t offset)
{
    (void)machine;
    return offset - DCHPRI < CHANNELS ? ((struct dma *)device)->priorities[(offset - DCHPRI) ^ 3] : 0;
}

static uint32_t read_register(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    struct dma *dma = (struct dma *)device;
    uint32_t value = 0;
    if (offset - DCHPRI < CHANNELS)
        return read_by_bytes(machine, device, offset, size);
    if (offset < DESCRIPTORS)
        return part_of_word(read_word(machine, dma, offset & ~3u), offset, size);
    if (offset - DESCRIPTORS + size <= sizeof dma->descriptors)
        memcpy(&value, (const uint8_t *)dma->descriptors + (offset - DESCRIPTORS), size);
    return value;
}

static void write_word(struct dma *dma, uint32_t offset, uint32_t value, uint32_t mask)
{
    uint32_t *word = word_at(dma, offset);
    if (offset == CR)
        dma->control = ((dma->control & ~mask) | value) & CR_BITS;
    else if (offset == INT || offset == ERR)
        *word &= ~value;
    else if (word)
        *word = ((*word & ~mask) | value) & ALL_CHANNELS;
}

static void change_controls(struct dma *dma, uint32_t channels, uint16_t cleared, uint16_t set)
{
    for (int32_t channel = 0; channel < CHANNELS; channel++)
        if (channels >> channel & 1)
            dma->descriptors[channel].control = (uint16_t)((dma->descriptors[channel].control & ~cleared) | set);
}

/* Write a register that sets or clears one bit, or all bits. */
static void command(struct dma *dma, uint32_t offset, uint8_t value)
{
    const uint32_t bits = value & COMMAND_ALL ? ALL_CHANNELS : 1u << (value & 0xF);
    if (value & NO_COMMAND)
        return;
    switch (offset) {
    case CEEI: dma->error_enabled &= ~bits; break;
    case SEEI: dma->error_enabled |= bits; break;
    case CERQ: dma->enabled &= ~bits; break;
    case SERQ: dma->enabled |= bits; break;
    case CDNE: change_controls(dma, bits, CSR_DONE, 0); break;
    case SSRT: change_controls(dma, bits, 0, CSR_START); break;
    case CERR: dma->errors &= ~bits; break;
    default: dma->interrupts &= ~bits; break;
    }
}

static bool is_command(uint32_t offset) { return offset >= CEEI && offset <= CINT; }

static void write_byte(struct machine *machine, struct device *device, uint32_t offset, uint8_t value)
{
    struct dma *dma = (struct dma *)device;
    if (is_command(offset))
        command(dma, offset, value);
    else if (offset - DCHPRI < CHANNELS)
        dma->priorities[(offset - DCHPRI) ^ 3] = value & DCHPRI_BITS;
    drive(machine, dma);
    look(machine, dma);
}

/* The controller's own bits of CSR are not changed. */
static void write_descriptor(struct dma *dma, uint32_t offset, uint32_t size, uint32_t value)
{
    struct descriptor *descriptor = &dma->descriptors[offset / sizeof *descriptor];
    const uint32_t place = offset % sizeof *descriptor;
    if (offset + size > sizeof dma->descriptors)
        return;
    const int32_t before = descriptor->control;
    memcpy((uint8_t *)dma->descriptors + offset, &value, size);
    if (place + size <= CSR_PLACE || place >= CSR_PLACE + CSR_BYTES)
        return;
    int32_t written = descriptor->control;
    const int32_t preserved = before & (CSR_ACTIVE | (written & CSR_DONE));
    if (preserved & CSR_DONE)
        written &= ~(CSR_MAJORELINK | CSR_ESG);
    descriptor->control = (uint16_t)((written & ~(CSR_ACTIVE | CSR_DONE)) | preserved);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct dma *dma = (struct dma *)device;
    const uint32_t shift = 8 * (offset & 3);
    if (is_command(offset) || offset - DCHPRI < CHANNELS)
        write_by_bytes(machine, device, offset, size, value);
    else if (offset < DESCRIPTORS)
        write_word(dma, offset & ~3u, value << shift, UINT32_MAX >> 8 * (4 - size) << shift);
    else
        write_descriptor(dma, offset - DESCRIPTORS, size, value);
    drive(machine, dma);
    look(machine, dma);
}

static void reset(struct machine *machine, struct device *device)
{
    struct dma *dma = (struct dma *)device;
    cancel_event(machine, &dma->event);
    dma->is_busy = false;
    dma->control = dma->error = dma->enabled = dma->error_enabled = dma->interrupts = dma->errors = dma->channel = 0;
    memset(dma->descriptors, 0, sizeof dma->descriptors);
    for (uint8_t channel = 0; channel < CHANNELS; channel++)
        dma->priorities[channel] = channel;
    drive(machine, dma);
}

/* -- DMAMUX ------------------------------------------------------------------------------------------------------- */

static uint32_t read_source(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    const struct dma *dma = ((struct multiplexer *)device)->dma;
    uint32_t value = 0;
    (void)machine;
    if (offset + size <= CHANNELS)
        memcpy(&value, &dma->sources[offset], size);
    return value;
}

/* Update the channels that timers gate. */
static void hold_channels(struct machine *machine, struct dma *dma)
{
    uint32_t held = 0;
    for (int32_t channel = 0; channel < HOLDABLE_CHANNELS; channel++)
        held |= (uint32_t)((dma->sources[channel] & CHCFG_TRIG) != 0) << channel;
    dma->triggered &= held;
    select_triggers(machine, dma->connections.timers, held);
}

static void write_source(struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct dma *dma = ((struct multiplexer *)device)->dma;
    if (offset + size > CHANNELS)
        return;
    memcpy(&dma->sources[offset], &value, size);
    hold_channels(machine, dma);
    look(machine, dma);
}

static void reset_multiplexer(struct machine *machine, struct device *device)
{
    struct dma *dma = ((struct multiplexer *)device)->dma;
    memset(dma->sources, 0, sizeof dma->sources);
    hold_channels(machine, dma);
}

void trigger_request(struct machine *machine, int32_t channel)
{
    struct dma *dma = (struct dma *)machine->dma[0];
    if (!is_asked(machine, dma, (uint32_t)channel))
        return;
    dma->triggered |= 1u << channel;
    look(machine, dma);
}

static void take_requests(struct machine *machine, struct device *device) { look(machine, (struct dma *)device); }

void machine_set_request(struct machine *machine, int32_t source, bool level)
{
    const uint64_t bit = UINT64_C(1) << (source & 63);
    if (level == (bool)(machine->requests & bit))
        return;
    machine->requests ^= bit;
    forget_answers(machine); /* a minor loop may begin */
    for (int32_t n = 0; level && n < 2 && machine->dma[n]; n++)
        machine->dma[n]->take_requests(machine, machine->dma[n]);
}

bool machine_add_dma(struct machine *machine, struct machine_dma connections)
{
    const struct dma dma = {
        .device = {
            .base = connections.base, .bytes = REGISTER_BYTES, .read = read_register, .read_byte = read_priority,
            .write = write_register, .write_byte = write_byte, .reset = reset, .take_requests = take_requests},
        .event.fire = go_on, .connections = connections};
    machine->dma[0] = add_device(machine, &dma.device, sizeof dma);
    const struct multiplexer multiplexer = {
        .device = {
            .base = connections.multiplexer, .bytes = PAGE_BYTES, .read = read_source, .write = write_source,
            .reset = reset_multiplexer},
        .dma = (struct dma *)machine->dma[0]};
    return machine->dma[0] && add_device(machine, &multiplexer.device, sizeof multiplexer);
}
