/* Random programs on the core, to be compiled with sanitizers: `fuzz_programs SEED COUNT`.
 *
 * Each program is made of random instances of the decoder's encodings and of random halfwords, in RAM that is vector
 * table, code, data and stack at once, so that it rewrites itself. Interrupts come at random, faults are delivered, and
 * devices answer anything. It prints why the core stopped, and how often, and a digest of all states at the end, which is
 * the same on every host.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "decode.h"
#include "machine.h"

enum { RAM = 0x20000000, RAM_BYTES = 0x8000, FLASH_BYTES = 0x2000, PROGRAMS_A_MACHINE = 200, RUNS = 60, REASONS = 32,
       VECTORS = 96 };

static uint64_t chance;

/* SplitMix64, by Sebastiano Vigna. */
static uint32_t random_word(void)
{
    uint64_t z = chance += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ z >> 30) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ z >> 27) * UINT64_C(0x94D049BB133111EB);
    return (uint32_t)(z ^ z >> 31);
}

static uint32_t random_below(uint32_t limit) { return random_word() % limit; }

static uint32_t read_device(void *context, uint32_t address, uint32_t size, bool *refused)
{
    struct machine *machine = context;
    (void)address;
    (void)size;
    *refused = random_below(16) == 0;
    if (random_below(8) == 0) {
        int32_t line = (int32_t)random_below(64); /* arguments have no order */
        machine_set_line(machine, line, random_below(2));
    }
    return random_word();
}

static void write_device(void *context, uint32_t address, uint32_t size, uint32_t value, bool *refused)
{
    (void)value;
    (void)read_device(context, address, size, refused);
}

/* A word that is often an address in RAM, of code or of data. */
static uint32_t random_value(void)
{
    switch (random_below(4)) {
    case 0: return random_word();
    case 1: return random_below(256);
    case 2: return (RAM + random_below(RAM_BYTES)) | 1;
    default: return RAM + random_below(RAM_BYTES / 4) * 4;
    }
}

static void write_halfword(uint8_t *bytes, uint32_t value)
{
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

/* The rows of the decoder's tables, and where those of four bytes begin. */
enum { ROWS = 1024 };
static const struct encoding *rows[ROWS];
static uint32_t row_count, first_wide;

static void gather_rows(void)
{
    const struct encoding_group *const tables[] = {narrow_groups, data_groups, access_groups, float_groups};
    for (int table = 0; table < 4; table++) {
        for (const struct encoding_group *group = tables[table]; group->count; group++)
            for (int row = 0; row < group->count && row_count < ROWS; row++)
                rows[row_count++] = &group->rows[row];
        if (table == 0)
            first_wide = row_count;
    }
}

static void fill(uint8_t *bytes, uint32_t size)
{
    for (uint32_t at = 0; at + 4 <= size;) {
        const uint32_t row = random_below(row_count);
        const struct encoding *encoding = rows[row];
        uint32_t bits = (random_word() & ~encoding->mask) | encoding->value;
        if (random_below(16) == 0)
            bits = random_value();
        if (row >= first_wide) {
            write_halfword(&bytes[at], bits >> 16);
            at += 2;
        }
        write_halfword(&bytes[at], bits);
        at += 2;
    }
}

static struct machine *new_machine(void)
{
    struct machine *machine = machine_create(random_below(8) == 0);
    if (!machine || !machine_add_memory(machine, 0, FLASH_BYTES, false)
        || !machine_add_memory(machine, RAM, RAM_BYTES, true))
        exit(2);
    machine_connect(machine, (struct machine_bus){machine, read_device, write_device});
    static const char *const prices[] = {"data", "load", "store", "branch", "refill_direct", "fp", "exception_entry"};
    for (size_t i = 0; i < sizeof prices / sizeof prices[0]; i++)
        machine_set_price(machine, 0, prices[i], (int32_t)random_below(4));
    return machine;
}

static uint32_t random_code_address(void) { return RAM + random_below(RAM_BYTES / 2) * 2; }

static void fill_memories(struct machine *machine)
{
    static uint8_t bytes[RAM_BYTES];
    fill(bytes, sizeof bytes);
    for (uint32_t vector = 0; vector < VECTORS; vector++) {
        uint32_t handler = random_below(32) ? random_code_address() | 1 : random_value();
        write_halfword(&bytes[4 * vector], handler);
        write_halfword(&bytes[4 * vector + 2], handler >> 16);
    }
    machine_write(machine, RAM, sizeof bytes, bytes);
    fill(bytes, FLASH_BYTES);
    machine_write(machine, 0, FLASH_BYTES, bytes);
}

static void prepare_core(struct machine *machine)
{
    struct core *core = machine_core(machine);
    machine_reset(machine);
    for (int i = 0; i < 15; i++)
        core->r[i] = random_value();
    for (int i = 0; i < 32; i++)
        core->s[i] = random_word();
    core->r[13] = RAM + random_below(RAM_BYTES / 4) * 4;
    core->r[15] = random_code_address();
    core->fpscr = random_below(2) ? 0 : random_word() & 0xF7C0009F;
    core->vector_table = random_below(16) ? RAM : random_value() & ~0x7Fu;
    core->fault_enabled = random_word();
    core->divide_traps = random_below(2);
    core->unaligned_traps = random_below(8) == 0;
    core->delivers_faults = random_below(2);
    core->may_loop = random_below(2);
    core->sends_on_pend = random_below(2);
    machine_set_fpu(machine, random_below(8) != 0);
    for (int i = 0; i < 64; i++) {
        machine_set_enabled(machine, i, random_below(2));
        machine_set_priority(machine, 16 + i, random_word());
    }
}

/* Run a program for some time, and elsewhere when it cannot go on; counts its reasons to stop. */
static void run_program(struct machine *machine, long long *reasons)
{
    struct core *core = machine_core(machine);
    for (int run = 0; run < RUNS; run++) {
        core->deadline = core->cycles + random_below(2000);
        core->instruction_limit = core->instructions + 1 + random_below(2000);
        int32_t reason = machine_run(machine);
        reasons[reason]++;
        if (reason == STOP_FAULT && core->delivers_faults) {
            if (!machine_deliver_fault(machine))
                prepare_core(machine); /* lockup */
        } else if (reason == STOP_FAULT || reason == STOP_LOOP) {
            core->r[15] = random_code_address();
            core->thumb = 1;
        } else if (reason == STOP_SLEEP) {
            core->cycles += random_below(1000);
            core->sleeping = random_below(4) == 0;
        }
        if (random_below(4) == 0)
            machine_pend(machine, 2 + (int32_t)random_below(70));
        if (random_below(16) == 0) {
            uint32_t address = random_code_address();
            machine_set_breakpoint(machine, address, random_below(2));
        }
    }
}

/* FNV-1a over some words. */
static uint64_t digest(uint64_t hash, const uint32_t *words, size_t count)
{
    for (size_t i = 0; i < count; i++)
        hash = (hash ^ words[i]) * UINT64_C(0x100000001B3);
    return hash;
}

int main(int argc, char **argv)
{
    if (argc != 3)
        return 2;
    chance = strtoull(argv[1], NULL, 0);
    long long count = strtoll(argv[2], NULL, 0), reasons[REASONS] = {0}, instructions = 0;
    struct machine *machine = NULL;
    gather_rows();
    uint64_t hash = UINT64_C(0xCBF29CE484222325);
    for (long long i = 0; i < count; i++) {
        if (i % PROGRAMS_A_MACHINE == 0) {
            machine_destroy(machine);
            machine = new_machine();
        }
        fill_memories(machine);
        prepare_core(machine);
        int64_t before = machine_core(machine)->instructions;
        run_program(machine, reasons);
        const struct core *core = machine_core(machine);
        instructions += core->instructions - before;
        const uint32_t counts[] = {(uint32_t)core->cycles, core->fpscr, machine_xpsr(machine)};
        hash = digest(digest(digest(hash, core->r, 16), core->s, 32), counts, 3);
    }
    machine_destroy(machine);
    printf("%lld programs, %lld instructions, digest %016llx\n", count, instructions, (unsigned long long)hash);
    for (int i = 0; i < REASONS; i++)
        if (reasons[i])
            printf("reason %d: %lld\n", i, reasons[i]);
    return 0;
}
