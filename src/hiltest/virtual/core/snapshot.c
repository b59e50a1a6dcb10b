/* Snapshots: the state of a machine with its memories, to be restored on it or on another machine.
 *
 * Snapshots share equal pages. A page of a memory has a copy from a snapshot until the page is written, and
 * for that reason the first store to it after a snapshot is checked. So a snapshot
 * copies only pages that were written since the previous one.
 */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "code.h"

struct snapshot_memory {
    uint32_t base, size;
    bool writable;
};

struct snapshot {
    struct core core;
    struct history history;
    bool has_waits; /* state of the memories' waits */
    struct memory_waits waits;
    struct device_states *devices; /* of `machine`, or NULL */
    const struct machine *machine;
    int memory_count;
    struct snapshot_memory memories[MEMORIES];
    uint32_t page_count;
    struct page *pages[]; /* of all memories, one after the other */
};

/* -- pages ------------------------------------------------------------------------------------------------------- */

static void release(struct page *page)
{
    if (page && --page->holders == 0)
        free(page);
}

static uint32_t pages_of(const struct memory *memory) { return memory->size / PAGE_BYTES; }

bool begin_copies(struct memory *memory)
{
    memory->copies = calloc(pages_of(memory), sizeof *memory->copies);
    return memory->copies;
}

void destroy_copies(struct memory *memory)
{
    for (uint32_t page = 0; memory->copies && page < pages_of(memory); page++)
        release(memory->copies[page]);
    free(memory->copies);
}

void drop_copies(struct machine *machine, struct memory *memory, uint32_t offset, uint32_t size)
{
    if (!size)
        return;
    for (uint32_t page = offset / PAGE_BYTES; page <= (offset + size - 1) / PAGE_BYTES; page++) {
        if (!memory->copies[page])
            continue;
        release(memory->copies[page]);
        memory->copies[page] = NULL;
        open_page(machine, memory, page * PAGE_BYTES);
    }
}

/* Return the copy of a page, which is made if necessary. NULL if out of memory. */
static struct page *copy_of(struct machine *machine, struct memory *memory, uint32_t page)
{
    if (memory->copies[page])
        return memory->copies[page];
    struct page *copy = malloc(sizeof *copy);
    if (!copy)
        return NULL;
    copy->holders = 1;
    memcpy(copy->bytes, memory->bytes + page * PAGE_BYTES, PAGE_BYTES);
    memory->copies[page] = copy;
    machine->writable[memory->base / PAGE_BYTES + page] = NULL; /* the first store to it must be checked */
    return copy;
}

/* Return whether two states of a page differ in bytes that were decoded as instructions. */
static bool differs_in_code(const uint8_t *has_code, const uint8_t *before, const uint8_t *after)
{
    for (uint32_t halfword = 0; halfword < PAGE_BYTES / 2; halfword++)
        if (has_code[halfword] && memcmp(before + 2 * halfword, after + 2 * halfword, 2) != 0)
            return true;
    return false;
}

/* Restore a page of a memory from a copy. */
static void restore_page(struct machine *machine, struct memory *memory, uint32_t page, struct page *copy)
{
    uint8_t *bytes = memory->bytes + page * PAGE_BYTES;
    if (memory->copies[page] == copy)
        return;
    if (differs_in_code(memory->has_code + page * PAGE_BYTES / 2, bytes, copy->bytes))
        machine->code_changed = true;
    memcpy(bytes, copy->bytes, PAGE_BYTES);
    release(memory->copies[page]);
    memory->copies[page] = copy;
    copy->holders++;
    open_page(machine, memory, page * PAGE_BYTES);
}

/* -- machines ---------------------------------------------------------------------------------------------------- */

static uint32_t count_pages(const struct machine *machine)
{
    uint32_t count = 0;
    for (int i = 0; i < machine->memory_count; i++)
        count += pages_of(&machine->memories[i]);
    return count;
}

static bool copy_memories(struct machine *machine, struct snapshot *snapshot)
{
    for (int i = 0; i < machine->memory_count; i++) {
        struct memory *memory = &machine->memories[i];
        snapshot->memories[i] = (struct snapshot_memory){memory->base, memory->size, memory->writable};
        for (uint32_t page = 0; page < pages_of(memory); page++) {
            struct page *copy = copy_of(machine, memory, page);
            if (!copy)
                return false;
            copy->holders++;
            snapshot->pages[snapshot->page_count++] = copy;
        }
    }
    snapshot->memory_count = machine->memory_count;
    return true;
}

struct snapshot *machine_snapshot(struct machine *machine, bool with_devices)
{
    struct snapshot *snapshot = malloc(sizeof *snapshot + count_pages(machine) * sizeof *snapshot->pages);
    if (!snapshot)
        return NULL;
    snapshot->core = machine->core;
    snapshot->history = machine->history;
    if (machine->running) /* the current instruction is not counted: the pipeline is the one before it, too */
        snapshot->history.pipeline = *code_state(machine, machine->running->state);
    snapshot->page_count = 0;
    snapshot->has_waits = machine->waits;
    if (machine->waits)
        snapshot->waits = *machine->waits;
    snapshot->devices = with_devices ? copy_devices(machine) : NULL;
    snapshot->machine = machine;
    if (!copy_memories(machine, snapshot) || (with_devices && !snapshot->devices)) {
        machine_forget_snapshot(snapshot);
        return NULL;
    }
    return snapshot;
}

void machine_forget_snapshot(struct snapshot *snapshot)
{
    if (!snapshot)
        return;
    for (uint32_t i = 0; i < snapshot->page_count; i++)
        release(snapshot->pages[i]);
    free(snapshot->devices);
    free(snapshot);
}

bool machine_read_snapshot(const struct snapshot *snapshot, uint32_t address, uint32_t size, uint8_t *bytes)
{
    struct page *const *pages = snapshot->pages;
    for (int i = 0; i < snapshot->memory_count; i++) {
        const struct snapshot_memory *memory = &snapshot->memories[i];
        uint32_t offset = address - memory->base;
        if (address >= memory->base && (uint64_t)offset + size <= memory->size) {
            for (uint32_t byte = 0; byte < size; byte++, offset++)
                bytes[byte] = pages[offset / PAGE_BYTES]->bytes[offset % PAGE_BYTES];
            return true;
        }
        pages += memory->size / PAGE_BYTES;
    }
    return false;
}

const struct core *machine_snapshot_core(const struct snapshot *snapshot) { return &snapshot->core; }

static bool has_same_memories(const struct machine *machine, const struct snapshot *snapshot)
{
    if (machine->memory_count != snapshot->memory_count)
        return false;
    for (int i = 0; i < machine->memory_count; i++) {
        const struct memory *memory = &machine->memories[i];
        const struct snapshot_memory *other = &snapshot->memories[i];
        if (memory->base != other->base || memory->size != other->size || memory->writable != other->writable)
            return false;
    }
    return true;
}

static void restore_memories(struct machine *machine, const struct snapshot *snapshot)
{
    struct page *const *copy = snapshot->pages;
    for (int i = 0; i < machine->memory_count; i++)
        for (uint32_t page = 0; page < pages_of(&machine->memories[i]); page++)
            restore_page(machine, &machine->memories[i], page, *copy++);
}

/* Restore the core without the settings of `machine_run`. */
static void restore_core(struct machine *machine, const struct core *state)
{
    struct core *core = &machine->core;
    if (core->fpu_enabled != state->fpu_enabled)
        machine->code_changed = true; /* nodes depend on CPACR's permission to use the FPU */
    memcpy(core, state, offsetof(struct core, deadline));
}

bool machine_restore(struct machine *machine, const struct snapshot *snapshot)
{
    if (machine->running || !has_same_memories(machine, snapshot)
        || (snapshot->devices && snapshot->machine != machine))
        return false;
    forget_answers(machine);
    restore_memories(machine, snapshot);
    restore_core(machine, &snapshot->core);
    machine->history = snapshot->history;
    if (machine->waits)
        waits_restore(machine->waits, snapshot->has_waits ? &snapshot->waits : NULL);
    machine->oldest_answer = snapshot->core.device_loads;
    if (snapshot->devices)
        restore_devices(machine, snapshot->devices);
    update_protection(machine);
    machine->must_check = true;
    calls_reset(machine);
    return true;
}

struct machine *machine_like(const struct machine *machine)
{
    struct machine *other = machine_create(machine->baseline);
    if (!other)
        return NULL;
    other->prices = machine->prices;
    memcpy(other->regions, machine->regions, sizeof other->regions);
    other->region_count = machine->region_count;
    other->passes_flash_stores = machine->passes_flash_stores;
    memcpy(other->blocks, machine->blocks, sizeof other->blocks);
    other->block_count = machine->block_count;
    if (machine->waits) {
        other->waits = malloc(sizeof *other->waits);
        if (!other->waits) {
            machine_destroy(other);
            return NULL;
        }
        *other->waits = *machine->waits;
    }
    for (int i = 0; i < machine->memory_count; i++) {
        const struct memory *memory = &machine->memories[i];
        uint32_t target = memory->base;
        for (int j = 0; memory->is_alias && j < i; j++)
            if (machine->memories[j].bytes == memory->bytes)
                target = machine->memories[j].base;
        if (target != memory->base ? !machine_add_alias(other, memory->base, target)
                : !machine_add_memory(other, memory->base, memory->size, memory->writable)) {
            machine_destroy(other);
            return NULL;
        }
    }
    return other;
}
