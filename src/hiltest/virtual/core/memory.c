/* The address space: memories, bit-band aliases, and the bus for everything else. */
#include <stdlib.h>
#include <string.h>

#include "code.h"
#include "devices.h"

enum {
    PERIPHERALS = 0x40000000, PERIPHERAL_BYTES = 0x100000,
    SRAM_BASE = 0x20000000, SRAM_ALIAS = 0x22000000, PERIPHERAL_ALIAS = 0x42000000, ALIAS_BYTES = 0x2000000,
};
static const uint32_t PRIVATE_PERIPHERALS = 0xE0000000, PRIVATE_BYTES = 0x100000;

/* The host must have the byte order of the part, as in execute.c. */
static uint32_t assemble(const uint8_t *bytes, uint32_t size)
{
    uint32_t value = 0;
    memcpy(&value, bytes, size);
    return value;
}

/* -- watchpoints ----------------------------------------------------------------------------------------------- */

/* Return a watchpoint of some kinds that has bytes of a range, or NULL. */
static const struct watchpoint *watchpoint_within(
    const struct machine *machine, uint32_t address, uint32_t size, uint32_t kinds)
{
    for (int i = 0; i < machine->watchpoint_count; i++) {
        const struct watchpoint *watchpoint = &machine->watchpoints[i];
        if (watchpoint->kinds & kinds && watchpoint->address - address < size)
            return watchpoint;
        if (watchpoint->kinds & kinds && address - watchpoint->address < watchpoint->size)
            return watchpoint;
    }
    return NULL;
}

/* Record a completed access if it met a watchpoint. */
static void look_at_access(struct machine *machine, uint32_t address, uint32_t size, uint32_t kind)
{
    const struct watchpoint *watchpoint = watchpoint_within(machine, address, size, kind);
    if (!watchpoint || machine->core.watch_kinds)
        return;
    machine->core.watch_kinds = watchpoint->kinds;
    machine->core.watch_address = address < watchpoint->address ? watchpoint->address : address;
    machine->must_check = true;
}

/* -- memories -------------------------------------------------------------------------------------------------- */

static bool overlaps(const struct memory *memory, uint32_t base, uint32_t size)
{
    return (uint64_t)base < (uint64_t)memory->base + memory->size && (uint64_t)memory->base < (uint64_t)base + size;
}

/* Accesses must be checked at watchpoints, in code, and in pages that have a copy. */
void open_page(struct machine *machine, const struct memory *memory, uint32_t offset)
{
    uint32_t address = memory->base + offset;
    const bool is_checked = machine->protects || watchpoint_within(machine, address, PAGE_BYTES, WATCH_ACCESS);
    uint8_t *bytes = is_checked ? NULL : memory->bytes + offset;
    bool opens = memory->writable && !memory->copies[offset / PAGE_BYTES]
        && !memchr(memory->has_code + offset / 2, 1, PAGE_BYTES / 2);
    machine->readable[address >> PAGE_BITS] = bytes;
    machine->writable[address >> PAGE_BITS] = opens ? bytes : NULL;
}

const uint8_t *machine_add_memory(struct machine *machine, uint32_t base, uint32_t size, bool writable)
{
    if (!size || (base | size) % PAGE_BYTES || (uint64_t)base + size > UINT64_C(1) << 32
        || machine->memory_count == MEMORIES)
        return NULL;
    for (int i = 0; i < machine->memory_count; i++)
        if (overlaps(&machine->memories[i], base, size))
            return NULL;
    struct memory memory = {
        .base = base, .size = size, .writable = writable, .bytes = calloc(size, 1), .has_code = calloc(size / 2, 1)};
    if (!begin_copies(&memory) || !memory.bytes || !memory.has_code) {
        free(memory.bytes);
        free(memory.has_code);
        destroy_copies(&memory);
        return NULL;
    }
    machine->memories[machine->memory_count++] = memory;
    for (uint32_t offset = 0; offset < size; offset += PAGE_BYTES)
        open_page(machine, &memory, offset);
    return memory.bytes;
}

const uint8_t *machine_add_alias(struct machine *machine, uint32_t base, uint32_t target)
{
    const struct memory *original = memory_at(machine, target, 1);
    if (!original || machine->memory_count == MEMORIES)
        return NULL;
    for (int i = 0; i < machine->memory_count; i++)
        if (overlaps(&machine->memories[i], base, original->size))
            return NULL;
    struct memory alias = *original;
    alias.base = base;
    alias.is_alias = true;
    machine->memories[machine->memory_count++] = alias;
    for (uint32_t offset = 0; offset < alias.size; offset += PAGE_BYTES)
        open_page(machine, &alias, offset);
    return alias.bytes;
}

struct memory *memory_at(struct machine *machine, uint32_t address, uint32_t size)
{
    for (int i = 0; i < machine->memory_count; i++) {
        struct memory *memory = &machine->memories[i];
        if (address >= memory->base && (uint64_t)address + size <= (uint64_t)memory->base + memory->size)
            return memory;
    }
    return NULL;
}

bool machine_holds_stack(struct machine *machine, uint32_t address, uint32_t size)
{
    const struct memory *memory = memory_at(machine, address, size);
    return memory && memory->writable;
}

bool machine_read(struct machine *machine, uint32_t address, uint32_t size, uint8_t *bytes)
{
    const struct memory *memory = memory_at(machine, address, size);
    if (!memory)
        return false;
    memcpy(bytes, memory->bytes + (address - memory->base), size);
    return true;
}

/* Drop decoded instructions if a write changes any of them. */
static void forget_changed_code(struct machine *machine, struct memory *memory, uint32_t offset, uint32_t size)
{
    for (uint32_t halfword = offset / 2; halfword <= (offset + size - 1) / 2; halfword++)
        if (memory->has_code[halfword]) {
            machine->code_changed = machine->must_check = true;
            return;
        }
}

bool machine_write(struct machine *machine, uint32_t address, uint32_t size, const uint8_t *bytes)
{
    struct memory *memory = memory_at(machine, address, size);
    if (!memory)
        return false;
    uint32_t offset = address - memory->base;
    drop_copies(machine, memory, offset, size);
    if (size && memcmp(memory->bytes + offset, bytes, size) != 0) {
        forget_changed_code(machine, memory, offset, size);
        memcpy(memory->bytes + offset, bytes, size);
    }
    if (machine->waits && !memory->writable)
        waits_reset(machine->waits); /* flash was loaded or programmed */
    return true;
}

void mark_code(struct machine *machine, uint32_t address, uint32_t size)
{
    struct memory *memory = memory_at(machine, address, size);
    if (!memory)
        return;
    for (uint32_t offset = 0; offset < size; offset += 2) {
        memory->has_code[(address + offset - memory->base) / 2] = 1;
        machine->writable[(address + offset) >> PAGE_BITS] = NULL; /* stores to it must be checked */
    }
}

void unmark_code(struct machine *machine)
{
    for (int i = 0; i < machine->memory_count; i++) {
        struct memory *memory = &machine->memories[i];
        memset(memory->has_code, 0, memory->size / 2);
        for (uint32_t offset = 0; memory->writable && offset < memory->size; offset += PAGE_BYTES)
            open_page(machine, memory, offset);
    }
}

/* -- accesses of the core --------------------------------------------------------------------------------------- */

static bool is_within(uint32_t address, uint32_t base, uint32_t size) { return address - base < size; }

/* Return whether accesses to an address go to the bus; a machine without a bus has only memories. */
static bool is_device(const struct machine *machine, uint32_t address)
{
    if (!machine->bus.read)
        return false;
    for (int32_t i = 0; i < machine->region_count; i++)
        if (is_within(address, machine->regions[i].base, machine->regions[i].size))
            return true;
    return is_within(address, PERIPHERALS, PERIPHERAL_BYTES) || is_within(address, PRIVATE_PERIPHERALS, PRIVATE_BYTES);
}

bool machine_add_device_region(struct machine *machine, uint32_t base, uint32_t size)
{
    if (machine->region_count == BUS_REGIONS)
        return false;
    machine->regions[machine->region_count].base = base;
    machine->regions[machine->region_count++].size = size;
    return true;
}

void machine_pass_flash_stores(struct machine *machine) { machine->passes_flash_stores = true; }

static bool is_alias(const struct machine *machine, uint32_t address)
{
    return !machine->baseline
        && (is_within(address, SRAM_ALIAS, ALIAS_BYTES) || is_within(address, PERIPHERAL_ALIAS, ALIAS_BYTES));
}

static bool refuse(struct machine *machine, int32_t cause, uint32_t address, uint32_t size)
{
    note_fault(machine, FAULT_DATA_BUS, cause, machine->core.r[15], address, 0, size);
    return false;
}

/* Describe the fault of an access through an alias: the alias is the address, and its target the value. A store faults
 * in the load that it begins with, but is still a store. */
static bool name_alias(struct machine *machine, bool stores, uint32_t address)
{
    struct machine_fault *fault = &machine->core.fault;
    if (stores && fault->cause == CAUSE_READ_UNMAPPED)
        fault->cause = CAUSE_WRITE_UNMAPPED;
    else if (stores && fault->cause == CAUSE_READ_REFUSED)
        fault->cause = CAUSE_WRITE_REFUSED;
    else if (stores && fault->cause == CAUSE_READ_PROTECTED)
        fault->cause = CAUSE_WRITE_PROTECTED;
    fault->value = fault->address;
    fault->address = address;
    return false;
}

static bool read_device(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value)
{
    bool refused = false;
    struct device *device = device_at(machine, address, size);
    expect_answer(machine, address, size);
    if (!device)
        report_repeats(machine);
    *value = read_bus(machine, device, address, size, &refused);
    if (refused)
        return refuse(machine, CAUSE_READ_REFUSED, address, size);
    remember_answer(machine, address, size, *value);
    machine->answers[machine->core.device_loads++ % ANSWERS] = *value;
    return true;
}

static bool write_device(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    bool refused = false;
    forget_answers(machine);
    write_bus(machine, device_at(machine, address, size), address, size, value, &refused);
    return !refused || refuse(machine, CAUSE_WRITE_REFUSED, address, size);
}

/* Return the address of the byte, halfword or word with an alias's bit, and the number of the bit (DDI 0403E, B3.1). */
static uint32_t aliased(uint32_t address, uint32_t size, uint32_t *bit)
{
    uint32_t region = is_within(address, SRAM_ALIAS, ALIAS_BYTES) ? SRAM_ALIAS : PERIPHERAL_ALIAS;
    uint32_t number = (address - region) >> 2;
    *bit = number & (8 * size - 1);
    return region - ALIAS_BYTES + (number >> 3 & ~(size - 1));
}

static bool load_elsewhere(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value)
{
    const struct memory *memory = memory_at(machine, address, size);
    if (memory && machine->protects && !is_permitted(machine, address, size, false))
        return refuse(machine, CAUSE_READ_PROTECTED, address, size);
    if (memory) {
        *value = assemble(memory->bytes + (address - memory->base), size);
        return true;
    }
    if (is_alias(machine, address)) {
        uint32_t bit = 0, target = aliased(address, size, &bit);
        if (!load_elsewhere(machine, target, size, value))
            return name_alias(machine, false, address);
        *value = *value >> bit & 1;
        return true;
    }
    if (is_device(machine, address))
        return read_device(machine, address, size, value);
    if (size > 1 && memory_at(machine, address, 1) && memory_at(machine, address + size - 1, 1)) {
        *value = 0; /* it crosses two adjacent memories */
        for (uint32_t i = 0; i < size; i++) {
            uint32_t byte = 0;
            if (!load_elsewhere(machine, address + i, 1, &byte))
                return false;
            *value |= byte << 8 * i;
        }
        return true;
    }
    return refuse(machine, CAUSE_READ_UNMAPPED, address, size);
}

bool load(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value)
{
    const uint8_t *bytes = plain_bytes(machine, address, size);
    if (bytes) {
        *value = assemble(bytes, size);
        return true;
    }
    if (!recall_answer(machine, address, size, value) && !load_elsewhere(machine, address, size, value))
        return false;
    look_at_access(machine, address, size, WATCH_READ);
    return true;
}

static bool store_elsewhere(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    struct memory *memory = memory_at(machine, address, size);
    if (memory && machine->protects && !is_permitted(machine, address, size, true))
        return refuse(machine, CAUSE_WRITE_PROTECTED, address, size);
    if (memory && !memory->writable && machine->passes_flash_stores && machine->bus.read)
        return write_device(machine, address, size, value);
    if (memory && !memory->writable)
        return refuse(machine, CAUSE_WRITE_FLASH, address, size);
    if (memory)
        return machine_write(machine, address, size, (const uint8_t *)&value);
    if (is_alias(machine, address)) {
        uint32_t bit = 0, before = 0, target = aliased(address, size, &bit);
        if (!load_elsewhere(machine, target, size, &before)
            || !store_elsewhere(machine, target, size, (before & ~(1u << bit)) | (value & 1) << bit))
            return name_alias(machine, true, address);
        return true;
    }
    if (is_device(machine, address))
        return write_device(machine, address, size, value);
    if (size > 1 && machine_holds_stack(machine, address, 1) && machine_holds_stack(machine, address + size - 1, 1)) {
        for (uint32_t i = 0; i < size; i++)
            if (!store_elsewhere(machine, address + i, 1, value >> 8 * i & 0xFF))
                return false;
        return true;
    }
    return refuse(machine, CAUSE_WRITE_UNMAPPED, address, size);
}

bool store(struct machine *machine, uint32_t address, uint32_t size, uint32_t value)
{
    uint8_t *bytes = writable_bytes(machine, address, size);
    if (!bytes) {
        if (!store_elsewhere(machine, address, size, value))
            return false;
        look_at_access(machine, address, size, WATCH_WRITE);
        return true;
    }
    memcpy(bytes, &value, size);
    return true;
}

void open_all_pages(struct machine *machine)
{
    for (int i = 0; i < machine->memory_count; i++)
        for (uint32_t offset = 0; offset < machine->memories[i].size; offset += PAGE_BYTES)
            open_page(machine, &machine->memories[i], offset);
}

bool machine_add_watchpoint(struct machine *machine, uint32_t address, uint32_t size, uint32_t kinds)
{
    if (machine->watchpoint_count == WATCHPOINTS)
        return false;
    machine->watchpoints[machine->watchpoint_count++] = (struct watchpoint){address, size, kinds};
    open_all_pages(machine);
    return true;
}

void machine_clear_watchpoints(struct machine *machine)
{
    machine->watchpoint_count = 0;
    machine->core.watch_kinds = 0;
    open_all_pages(machine);
}

bool fetch(struct machine *machine, uint32_t address, uint16_t *halfword)
{
    const struct memory *memory = memory_at(machine, address, 2);
    if (!memory)
        return false;
    *halfword = (uint16_t)assemble(memory->bytes + (address - memory->base), 2);
    return true;
}

bool is_same_block(const struct machine *machine, uint32_t one, uint32_t other)
{
    if (machine->block_count == 0)
        return (one < SYSTEM_BUS) == (other < SYSTEM_BUS);
    for (uint32_t i = 0; i < machine->block_count; i++) {
        if ((one < machine->blocks[i]) != (other < machine->blocks[i]))
            return false;
    }
    return true;
}
