/* Cache of devices' answers: a register is read again only if it may have changed.
 *
 * Waiting firmware reads the same register over and over, and a device in Python takes a hundred times longer than
 * the instruction. Devices declare the bytes that change only at events and stores. An answer from such bytes holds
 * until the machine returns, an event fires, a store reaches a device, a load changes one, or an exception is
 * entered or left.
 */
#include <stddef.h>

#include "state.h"

static const uint32_t LARGE_PRIME = 0x9E3779B1;

static const uint8_t *declared_page(const struct machine *machine, uint32_t address)
{
    const struct known_answers *cache = &machine->answer_cache;
    const uint32_t page = address % DEVICE_BYTES / PAGE_BYTES;
    return address - DEVICE_BASE < DEVICE_BYTES ? cache->devices[page]
        : address - PRIVATE_BASE < DEVICE_BYTES ? cache->private_devices[page] : NULL;
}

bool machine_declare_page(struct machine *machine, uint32_t base, const uint8_t *bytes)
{
    struct known_answers *cache = &machine->answer_cache;
    const uint32_t page = base % DEVICE_BYTES / PAGE_BYTES;
    if (base - DEVICE_BASE < DEVICE_BYTES)
        cache->devices[page] = bytes;
    else if (base - PRIVATE_BASE < DEVICE_BYTES)
        cache->private_devices[page] = bytes;
    else
        return false;
    return true;
}

/* Return the common bits of enum device_byte of all bytes of an access; none if it crosses pages. */
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
    return &machine->answer_cache.entries[mixed >> 16 & (KNOWN_ANSWERS - 1)];
}

bool recall_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value)
{
    struct core *core = &machine->core;
    struct known_answer *entry = entry_of(machine, address);
    if (entry->era != machine->answer_cache.era || entry->address != address || entry->size != size
        || entry->place != core->r[15] || core->cycles >= entry->until)
        return false;
    struct known_answers *cache = &machine->answer_cache;
    if (entry->until < cache->soonest)
        cache->soonest = entry->until;
    if (++entry->reads == entry->patience) {
        cache->polled = entry;
        machine->must_check = true;
    }
    *value = entry->value;
    if (entry->counts_repeats) {
        entry->repeats++;
        entry->repeated_at = core->device_loads;
        cache->has_repeats = true;
    }
    machine->answers[core->device_loads++ % ANSWERS] = *value;
    return true;
}

/* Return the entry with uncounted repetitions whose last one came first, or NULL. */
static struct known_answer *oldest_repeated(struct known_answers *cache)
{
    struct known_answer *oldest = NULL;
    for (int i = 0; i < KNOWN_ANSWERS; i++) {
        struct known_answer *entry = &cache->entries[i];
        if (entry->repeats && (!oldest || entry->repeated_at < oldest->repeated_at))
            oldest = entry;
    }
    return oldest;
}

void report_repeats(struct machine *machine)
{
    struct known_answers *cache = &machine->answer_cache;
    while (cache->has_repeats) {
        struct known_answer *entry = oldest_repeated(cache);
        const int64_t repeats = entry ? entry->repeats : 0;
        if (entry) {
            entry->repeats = 0;
            count_accesses(machine, (struct machine_access){
                .address = entry->address, .place = entry->place, .size = entry->size, .count = repeats});
        }
        cache->has_repeats = entry;
    }
}

void forget_answers(struct machine *machine)
{
    struct known_answers *cache = &machine->answer_cache;
    cache->era++;
    cache->polled = NULL;
    report_repeats(machine);
}

void expect_answer(struct machine *machine, uint32_t address, uint32_t size)
{
    struct known_answers *cache = &machine->answer_cache;
    cache->declared = declared(machine, address, size);
    cache->asked++;
    cache->until = INT64_MAX;
    if (!(cache->declared & DEVICE_KEEPS))
        forget_answers(machine);
}

void remember_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    const struct core *core = &machine->core;
    struct known_answers *cache = &machine->answer_cache;
    if (!(cache->declared & DEVICE_STEADY) || cache->until <= core->cycles || core->executes_all)
        return;
    struct known_answer *entry = entry_of(machine, address);
    const bool is_another = entry->address != address || entry->place != core->r[15];
    *entry = (struct known_answer){
        .era = cache->era, .address = address, .place = core->r[15], .size = size, .value = value,
        .until = cache->until, .patience = is_another ? FIRST_PATIENCE : entry->patience,
        .counts_repeats = (cache->declared & DEVICE_COUNTS) != 0};
}

void machine_load_changed(struct machine *machine)
{
    machine->answer_cache.declared = 0;
    forget_answers(machine);
}

void hold_answer(struct machine *machine, int64_t until)
{
    if (until < machine->answer_cache.until)
        machine->answer_cache.until = until;
}
