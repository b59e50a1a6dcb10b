#include "execute.h"

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

/* Return the first address of a transfer; *after is the base after it, if that is written back. */
static uint32_t first_address(const struct core *core, const struct instruction *i, uint32_t *after)
{
    const uint32_t base = i->n == PROGRAM_COUNTER ? 0 : core->r[i->n];
    uint32_t bytes = 4u * i->words;
    switch (i->operation) {
    case OP_VLDM: case OP_VSTM: bytes = i->immediate; /* fall through */
    case OP_LDM: case OP_STM:
        *after = i->mode & MODE_BEFORE ? base - bytes : base + bytes;
        return i->mode & MODE_BEFORE ? *after : base;
    default: /* with an offset, or literal */
        *after = base + i->immediate;
        return i->mode & MODE_POST ? base : *after;
    }
}

uint32_t transfer_address(const struct core *core, const struct instruction *instruction)
{
    uint32_t after;
    return first_address(core, instruction, &after);
}

static void write_back(struct core *core, const struct instruction *instruction, uint32_t after)
{
    if (instruction->mode & MODE_WRITES_BACK)
        core->r[instruction->n] = after;
}

/* Load or store a word of a transfer at `bytes`, and advance them, or through the bus if they are NULL. */
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
    uint32_t after, address = first_address(core, instruction, &after), value;
    uint32_t base_value = core->r[instruction->n];
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    const uint8_t *bytes = plain_bytes(machine, address, 4u * instruction->words);
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
    uint32_t after, address = first_address(core, instruction, &after);
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    uint8_t *bytes = writable_bytes(machine, address, 4u * instruction->words);
    uint32_t registers = instruction->immediate & 0x7FFF;
    for (uint32_t number = 0; registers >> number; number++) {
        if (!(registers >> number & 1))
            continue;
        if (!store_word(machine, &bytes, address, core->r[number]))
            return false;
        address += 4;
    }
    write_back(core, instruction, after);
    return true;
}

bool load_double(struct machine *machine, const struct instruction *instruction)
{
    struct core *core = &machine->core;
    uint32_t after, first, second, address = first_address(core, instruction, &after);
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
    uint32_t after, address = first_address(core, instruction, &after);
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
bool load_floats(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = first_address(&machine->core, instruction, &after), words = instruction->words;
    uint32_t *values = &machine->core.s[instruction->d];
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    const uint8_t *bytes = plain_bytes(machine, address, 4 * words);
    for (uint32_t i = 0; i < words; i++)
        if (!load_word(machine, &bytes, address + 4 * i, &values[i]))
            return false;
    write_back(&machine->core, instruction, after);
    return true;
}

bool store_floats(struct machine *machine, const struct instruction *instruction)
{
    uint32_t after, address = first_address(&machine->core, instruction, &after), words = instruction->words;
    const uint32_t *values = &machine->core.s[instruction->d];
    if (!is_aligned(machine, address, 4, instruction->n, CAUSE_MISALIGNED))
        return false;
    uint8_t *bytes = writable_bytes(machine, address, 4 * words);
    for (uint32_t i = 0; i < words; i++)
        if (!store_word(machine, &bytes, address + 4 * i, values[i]))
            return false;
    write_back(&machine->core, instruction, after);
    return true;
}
