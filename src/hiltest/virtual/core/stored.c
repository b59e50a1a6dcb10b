/* Peripherals that are not modelled: their registers store writes. Accesses are counted by address and instruction, and
 * the host is told of the first one and of an instruction that polls; so firmware may poll as fast as any register. */
#include <string.h>

#include "devices.h"

struct stored {
    struct device device;
    uint8_t bytes[PAGE_BYTES], initial[PAGE_BYTES];
};

/* -- counts ------------------------------------------------------------------------------------------------------- */

static void report(const struct access_log *log, struct machine_access *access)
{
    const struct machine_access copy = *access;
    access->count = 0; /* before the host, which may ask for all counts */
    if (copy.count && log->report)
        log->report(log->context, &copy);
}

void count_accesses(struct machine *machine, struct machine_access access)
{
    struct access_log *log = &machine->accesses;
    if (log->is_paused)
        return;
    access.place = access.place ? access.place : machine->core.r[15];
    const uint32_t mixed = (access.address ^ access.place << 8 ^ access.is_write) * 0x9E3779B1u;
    struct machine_access *entry = &log->entries[mixed >> 16 & (LOGGED_ACCESSES - 1)];
    const bool is_new = !entry->size || entry->address != access.address || entry->place != access.place
        || entry->is_write != access.is_write;
    if (is_new) {
        report(log, entry);
        *entry = access;
        entry->count = entry->reads = 0;
    }
    if (access.is_write)
        log->writes++;
    if (access.is_write || entry->writes_before != log->writes)
        entry->reads = 0;
    entry->writes_before = log->writes;
    const bool polled = entry->reads >= MACHINE_POLLED_READS;
    entry->count += access.count;
    entry->reads += access.is_write ? 0 : access.count;
    log->latest = (int32_t)(entry - log->entries);
    if (is_new || (!polled && entry->reads >= MACHINE_POLLED_READS))
        report(log, entry);
}

void machine_note_access(struct machine *machine, struct machine_access access) { count_accesses(machine, access); }

void machine_log_accesses(struct machine *machine, machine_accessed report_access, void *context)
{
    machine->accesses.report = report_access;
    machine->accesses.context = context;
}

void machine_report_accesses(struct machine *machine)
{
    report_repeats(machine);
    for (int32_t i = 0; i < LOGGED_ACCESSES; i++)
        report(&machine->accesses, &machine->accesses.entries[i]);
}

void machine_forget_accesses(struct machine *machine)
{
    memset(machine->accesses.entries, 0, sizeof machine->accesses.entries);
}

void machine_pause_accesses(struct machine *machine, bool is_paused) { machine->accesses.is_paused = is_paused; }

struct machine_access machine_latest_access(struct machine *machine)
{
    report_repeats(machine);
    return machine->accesses.entries[machine->accesses.latest];
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static uint32_t read_register(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    const struct stored *stored = (struct stored *)device;
    count_accesses(machine, (struct machine_access){.address = device->base + offset, .size = size, .count = 1});
    uint32_t value = 0;
    memcpy(&value, stored->bytes + offset, size);
    return value;
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct stored *stored = (struct stored *)device;
    count_accesses(machine, (struct machine_access){
        .address = device->base + offset, .size = size, .value = value, .is_write = true, .count = 1});
    memcpy(stored->bytes + offset, &value, size);
}

static void reset(struct machine *machine, struct device *device)
{
    (void)machine;
    struct stored *stored = (struct stored *)device;
    memcpy(stored->bytes, stored->initial, sizeof stored->bytes);
}

bool machine_add_stored(struct machine *machine, uint32_t base, const uint8_t *initial)
{
    struct stored stored = {.device = {
        .base = base, .bytes = PAGE_BYTES, .read = read_register, .write = write_register, .reset = reset}};
    memcpy(stored.initial, initial, sizeof stored.initial);
    return add_device(machine, &stored.device, sizeof stored) != NULL;
}
