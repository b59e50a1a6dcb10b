/* Answers of devices that are known without asking: a register is asked again only if it may have changed.
 *
 * Firmware that waits reads the same register over and over, and a device in Python takes a hundred times longer than
 * the instruction. Devices declare which bytes change only at events and stores. An answer made of such bytes holds
 * until the machine returns, an event happens, something is stored to a device, a load changes one, or an exception is
 * entered or left.
 */
#include <stddef.h>

#include "state.h"

static const uint32_t LARGE_PRIME = 0x9E3779B1;

static const uint8_t *declared_page(const struct machine *machine, uint32_t address)
{
    const struct known_answers *known = &machine->known;
    const uint32_t page = address % DEVICE_BYTES / PAGE_BYTES;
    return address - DEVICE_BASE < DEVICE_BYTES ? known->devices[page]
        : address - PRIVATE_BASE < DEVICE_BYTES ? known->private_devices[page] : NULL;
}

bool machine_declare_page(struct machine *machine, uint32_t base, const uint8_t *bytes)
{
    struct known_answers *known = &machine->known;
    const uint32_t page = base % DEVICE_BYTES / PAGE_BYTES;
    if (base - DEVICE_BASE < DEVICE_BYTES)
        known->devices[page] = bytes;
    else if (base - PRIVATE_BASE < DEVICE_BYTES)
        known->private_devices[page] = bytes;
    else
        return false;
    return true;
}

/* What all bytes of an access have in common: the bits of enum device_byte; nothing if they are of two pages. */
static uint8_t declared(const struct machine *machine, uint32_t address, uint32_t size)
{
    const uint32_t offset = address % PAGE_BYTES;
    const uint8_t *page = offset + size <= PAGE_BYTES ? declared_page(machine, address) : NULL;
    uint8_t common = page ? page[offset] : 0;
    for (uint32_t byte = 1; page && byte < size; byte++)
        common &= page[offset + byte];
    return common;
}

static struct known_answer *entry_of(struct machine *machine, uint32_t address)
{
    const uint32_t mixed = (address ^ machine->core.r[15] << 8) * LARGE_PRIME;
    return &machine->known.entries[mixed >> 16 & (KNOWN_ANSWERS - 1)];
}

bool recall_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value)
{
    struct core *core = &machine->core;
    struct known_answer *entry = entry_of(machine, address);
    if (entry->era != machine->known.era || entry->address != address || entry->size != size
        || entry->place != core->r[15] || core->cycles >= entry->until)
        return false;
    struct known_answers *known = &machine->known;
    if (entry->until < known->soonest)
        known->soonest = entry->until;
    if (++entry->reads == entry->patience) {
        known->polled = entry;
        machine->looks = true;
    }
    *value = entry->value;
    if (entry->is_told) {
        entry->repeats++;
        entry->repeated_at = core->device_loads;
        known->has_repeats = true;
    }
    machine->answers[core->device_loads++ % ANSWERS] = *value;
    return true;
}

/* The entry with repetitions that are not told yet whose last one came first, or NULL. */
static struct known_answer *oldest_repeated(struct known_answers *known)
{
    struct known_answer *oldest = NULL;
    for (int i = 0; i < KNOWN_ANSWERS; i++) {
        struct known_answer *entry = &known->entries[i];
        if (entry->repeats && (!oldest || entry->repeated_at < oldest->repeated_at))
            oldest = entry;
    }
    return oldest;
}

void tell_repeats(struct machine *machine)
{
    struct known_answers *known = &machine->known;
    while (known->has_repeats) {
        struct known_answer *entry = oldest_repeated(known);
        const int64_t repeats = entry ? entry->repeats : 0;
        if (entry) {
            entry->repeats = 0;
            known->tell(known->context, entry->address, entry->place, repeats);
        }
        known->has_repeats = entry;
    }
}

void forget_answers(struct machine *machine)
{
    struct known_answers *known = &machine->known;
    known->era++;
    known->polled = NULL;
    tell_repeats(machine);
}

void expect_answer(struct machine *machine, uint32_t address, uint32_t size)
{
    struct known_answers *known = &machine->known;
    known->declared = declared(machine, address, size);
    known->asked++;
    known->until = INT64_MAX;
    if (!(known->declared & DEVICE_KEEPS))
        forget_answers(machine);
}

void remember_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    const struct core *core = &machine->core;
    struct known_answers *known = &machine->known;
    if (!(known->declared & DEVICE_STEADY) || known->until <= core->cycles || core->executes_all)
        return;
    struct known_answer *entry = entry_of(machine, address);
    const bool is_another = entry->address != address || entry->place != core->r[15];
    *entry = (struct known_answer){
        .era = known->era, .address = address, .place = core->r[15], .size = size, .value = value,
        .until = known->until, .patience = is_another ? FIRST_PATIENCE : entry->patience,
        .is_told = known->tell && known->declared & DEVICE_TELLS};
}

void machine_tell_repeated(struct machine *machine, machine_repeated tell, void *context)
{
    machine->known.tell = tell;
    machine->known.context = context;
}

void machine_load_changed(struct machine *machine)
{
    machine->known.declared = 0;
    forget_answers(machine);
}

void hold_answer(struct machine *machine, int64_t until)
{
    if (until < machine->known.until)
        machine->known.until = until;
}
