#include "transfers.h"

#include <string.h>

enum { STACK_POINTER = 13, PROGRAM_COUNTER = 15 };

/* These transfers fault unless their address is a multiple of their size (DDI 0403E, A3.2.1). */
static bool is_aligned(struct machine *machine, uint32_t address, uint32_t size, uint32_t base, int32_t cause)
{
    if (address % size == 0)
        return true;
    uint32_t value = base < PROGRAM_COUNTER ? machine->core.r[base] : address;
    note_fault(machine, FAULT_UNALIGNED, cause, machine->core.r[PROGRAM_COUNTER], address, value, base);
    return false;
}

/* First address of a transfer, and the base behind so many bytes. */
static uint32_t first_address(
    const struct core *core, const struct instruction *instruction, uint32_t bytes, uint32_t *after)
{
    uint32_t base = core->r[instruction->n];
    bool is_downward = instruction->mode & MODE_BEFORE;
    *after = is_downward ? base - bytes : base + bytes;
    return is_downward ? *after : base;
}

/* The bytes of some words if they lie in one page of plain memory, else NULL. */
static const uint8_t *words_at(const struct machine *machine, uint32_t address, uint32_t words)
{
    const uint8_t *page = machine->readable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES + 4 * words <= PAGE_BYTES ? page + address % PAGE_BYTES : NULL;
}

static uint8_t *writable_words_at(const struct machine *machine, uint32_t address, uint32_t words)
{
    uint8_t *page = machine->writable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES + 4 * words <= PAGE_BYTES ? page + address % PAGE_BYTES : NULL;
}

/* Load or store a word of a transfer: from or to `bytes`, which are moved on, or elsewhere if there are none. */
static inline bool load_word(struct machine *machine, const uint8_t **bytes, uint32_t address, uint32_t *value)
{
    if (!*bytes)
        return load(machine, address, 4, value);
    memcpy(value, *bytes, 4);
    *bytes += 4;
    return true;
}

static inline bool store_word(struct machine *machine, uint8_t **bytes, uint32_t address, uint32_t value)
{
    if (!*bytes)
        return store(machine, address, 4, value);
    memcpy(*bytes, &value, 4);
    *bytes += 4;
    return true;
}

bool load_multiple(struct machine *machine, const struct instruction *instruction, uint32_t *target)
{
    struct core *core = &machine->core;
    uint32_t after, address = first_address(core, instruction, 4u * instruction->words, &after), value;
    uint32_t base_value = core->r[instruction->n];
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    const uint8_t *bytes = words_at(machine, address, instruction->words);
    uint32_t registers = instruction->immediate & 0xFFFF;
    for (uint32_t number = 0; registers >> number; number++) {
        if (!(registers >> number & 1))
            continue;
        if (!load_word(machine, &bytes, address, &value))
            return false;
        if (number == instruction->n)
            base_value = value;
        else if (number == PROGRAM_COUNTER)
            *target = value;
        else
            core->r[number] = value;
        address += 4;
    }
    bool writes_back = instruction->mode & MODE_WRITES_BACK && !(instruction->immediate >> instruction->n & 1);
    core->r[instruction->n] = writes_back ? after : base_value;
    return true;
}

bool store_multiple(struct machine *machine, const struct instruction *instruction)
{
    struct core *core = &machine->core;
    uint32_t after, address = first_address(core, instruction, 4u * instruction->words, &after);
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    uint8_t *bytes = writable_words_at(machine, address, instruction->words);
    uint32_t registers = instruction->immediate & 0x7FFF;
    for (uint32_t number = 0; registers >> number; number++) {
        if (!(registers >> number & 1))
            continue;
        if (!store_word(machine, &bytes, address, core->r[number]))
            return false;
        address += 4;
    }
    if (instruction->mode & MODE_WRITES_BACK)
        core->r[instruction->n] = after;
    return true;
}

/* Address of an access with an immediate offset, which may be literal; *after is the base if it is written back. */
static uint32_t offset_address(const struct core *core, const struct instruction *instruction, uint32_t *after)
{
    if (instruction->n == PROGRAM_COUNTER)
        return *after = instruction->immediate;
    uint32_t base = core->r[instruction->n];
    *after = base + instruction->immediate;
    return instruction->mode & MODE_POST ? base : *after;
}

uint32_t transfer_address(const struct core *core, const struct instruction *instruction)
{
    uint32_t after;
    switch (instruction->operation) {
    case OP_LDM: case OP_STM:
        return first_address(core, instruction, 4u * instruction->words, &after);
    case OP_VLDM: case OP_VSTM:
        return first_address(core, instruction, instruction->immediate, &after);
    default:
        return offset_address(core, instruction, &after);
    }
}

static void write_back(struct core *core, const struct instruction *instruction, uint32_t after)
{
    if (instruction->mode & MODE_WRITES_BACK && instruction->n != PROGRAM_COUNTER)
        core->r[instruction->n] = after;
}

bool load_double(struct machine *machine, const struct instruction *instruction)
{
    struct core *core = &machine->core;
    uint32_t after, first, second, address = offset_address(core, instruction, &after);
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED) || !load(machine, address, 4, &first)
        || !load(machine, address + 4, 4, &second))
        return false;
    write_back(core, instruction, after);
    core->r[instruction->d] = first;
    core->r[instruction->a] = second;
    return true;
}

bool store_double(struct machine *machine, const struct instruction *instruction)
{
    struct core *core = &machine->core;
    uint32_t after, address = offset_address(core, instruction, &after);
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED)
        || !store(machine, address, 4, core->r[instruction->d])
        || !store(machine, address + 4, 4, core->r[instruction->a]))
        return false;
    write_back(core, instruction, after);
    return true;
}

bool load_exclusive(struct machine *machine, const struct instruction *instruction, uint32_t size)
{
    struct core *core = &machine->core;
    uint32_t address = core->r[instruction->n] + instruction->immediate;
    if (!is_aligned(machine, address, size, instruction->n, CAUSE_EXCLUSIVE)
        || !load(machine, address, size, &core->r[instruction->d]))
        return false;
    machine->history.exclusive = true;
    machine->history.exclusive_address = address;
    return true;
}

bool store_exclusive(struct machine *machine, const struct instruction *instruction, uint32_t size)
{
    struct core *core = &machine->core;
    uint32_t address = core->r[instruction->n] + instruction->immediate;
    if (!is_aligned(machine, address, size, instruction->n, CAUSE_EXCLUSIVE))
        return false;
    bool passes = machine->history.exclusive && machine->history.exclusive_address == address;
    machine->history.exclusive = false;
    if (passes && !store(machine, address, size, core->r[instruction->a]))
        return false;
    core->r[instruction->d] = !passes;
    return true;
}

/* The decoder defines no transfer past s31. */
static bool load_words(struct machine *machine, uint32_t address, uint32_t first, uint32_t words, uint32_t base)
{
    if (!is_aligned(machine, address, 4, base, CAUSE_MISALIGNED))
        return false;
    const uint8_t *bytes = words_at(machine, address, words);
    if (bytes) {
        memcpy(&machine->core.s[first], bytes, 4 * words);
        return true;
    }
    for (uint32_t i = 0; i < words; i++)
        if (!load(machine, address + 4 * i, 4, &machine->core.s[first + i]))
            return false;
    return true;
}

static bool store_words(struct machine *machine, uint32_t address, uint32_t first, uint32_t words, uint32_t base)
{
    if (!is_aligned(machine, address, 4, base, CAUSE_MISALIGNED))
        return false;
    uint8_t *bytes = writable_words_at(machine, address, words);
    if (bytes) {
        memcpy(bytes, &machine->core.s[first], 4 * words);
        return true;
    }
    for (uint32_t i = 0; i < words; i++)
        if (!store(machine, address + 4 * i, 4, machine->core.s[first + i]))
            return false;
    return true;
}

bool load_floats(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = offset_address(&machine->core, instruction, &after);
    return load_words(machine, address, instruction->d, instruction->words, instruction->n);
}

bool store_floats(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = offset_address(&machine->core, instruction, &after);
    return store_words(machine, address, instruction->d, instruction->words, instruction->n);
}

bool load_float_registers(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = first_address(&machine->core, instruction, instruction->immediate, &after);
    if (!load_words(machine, address, instruction->d, instruction->words, instruction->n))
        return false;
    write_back(&machine->core, instruction, after);
    return true;
}

bool store_float_registers(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = first_address(&machine->core, instruction, instruction->immediate, &after);
    if (!store_words(machine, address, instruction->d, instruction->words, instruction->n))
        return false;
    write_back(&machine->core, instruction, after);
    return true;
}
