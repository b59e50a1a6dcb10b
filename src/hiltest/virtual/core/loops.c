/* Counting of the turns of waiting loops without executing each turn.
 *
 * An instruction has read a device over and over with a cached answer; or the core has been for a while in a short
 * loop that stores nothing, as if it waited for an interrupt that changes a variable. Then one turn is executed
 * step by step. If it returns to the same state of core and memory without asking a device, further
 * turns are equal up to an event or the deadline. The instructions need not be understood for that.
 */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "execute.h"

enum { MOST_STEPS = 256, MOST_WORDS = 64, WORD_BYTES = 4, MOST_PATIENCE = 1024, MOST_INSTRUCTIONS = 8 };

/* A step of a turn: the count of its node that it has raised. */
struct step {
    struct node *node;
    uint64_t *count;
};

struct word {
    uint32_t address;
    uint8_t bytes[WORD_BYTES];
};

/* The turn, and the state before it. */
struct turn {
    struct core core;
    struct history history;
    struct memory_waits waits;
    int64_t era, asked, repeats[KNOWN_ANSWERS];
    struct step steps[MOST_STEPS];
    uint32_t step_count;
    struct word words[MOST_WORDS]; /* previous values of stored words */
    uint32_t word_count;
    bool is_over;
};

/* -- memory ------------------------------------------------------------------------------------------------------- */

static bool keep_word(struct machine *machine, struct turn *turn, uint32_t address)
{
    for (uint32_t i = 0; i < turn->word_count; i++)
        if (turn->words[i].address == address)
            return true;
    if (turn->word_count == MOST_WORDS)
        return false;
    struct word *word = &turn->words[turn->word_count++];
    word->address = address;
    return machine_read(machine, address, WORD_BYTES, word->bytes);
}

/* Find the destination of an instruction's store; 0 bytes without one. False if it is unknown here. */
static bool find_store(const struct core *core, const struct instruction *i, uint32_t *address, uint32_t *size)
{
    *address = i->mode & MODE_POST ? core->r[i->n] : core->r[i->n] + i->immediate;
    switch (i->operation) {
    case OP_STR_I: case OP_STR_W: *size = 4; return true;
    case OP_STRH_I: case OP_STRH_W: *size = 2; return true;
    case OP_STRB_I: case OP_STRB_W: *size = 1; return true;
    case OP_STR_R: case OP_STRH_R: case OP_STRB_R:
        *address = core->r[i->n] + (core->r[i->m] << i->amount);
        *size = 4;
        return true;
    case OP_STM: case OP_STRD: case OP_VSTR: case OP_VSTM:
        *address = transfer_address(core, i);
        *size = WORD_BYTES * i->words;
        return true;
    case OP_STR_L: case OP_STRH_L: case OP_STRB_L: case OP_STREX: case OP_STREXB: case OP_STREXH:
        return false;
    default:
        *size = 0;
        return true;
    }
}

/* Save the memory that an instruction is about to overwrite. False if that is impossible. */
static bool keep_memory(struct machine *machine, struct turn *turn, const struct instruction *instruction)
{
    uint32_t address, size;
    if (!find_store(&machine->core, instruction, &address, &size))
        return false;
    const uint32_t end = size ? size + address % WORD_BYTES : 0;
    for (uint32_t offset = 0; offset < end; offset += WORD_BYTES)
        if (!keep_word(machine, turn, address - address % WORD_BYTES + offset))
            return false;
    return true;
}

static bool has_same_memory(struct machine *machine, const struct turn *turn)
{
    uint8_t bytes[WORD_BYTES];
    for (uint32_t i = 0; i < turn->word_count; i++)
        if (!machine_read(machine, turn->words[i].address, WORD_BYTES, bytes)
            || memcmp(bytes, turn->words[i].bytes, WORD_BYTES) != 0)
            return false;
    return true;
}

/* -- one turn ----------------------------------------------------------------------------------------------------- */

static void begin_turn(struct machine *machine, struct turn *turn)
{
    struct known_answers *cache = &machine->answer_cache;
    turn->core = machine->core;
    turn->history = machine->history;
    if (machine->waits)
        turn->waits = *machine->waits;
    turn->era = cache->era;
    turn->asked = cache->asked;
    for (int i = 0; i < KNOWN_ANSWERS; i++)
        turn->repeats[i] = cache->entries[i].repeats;
    turn->step_count = turn->word_count = 0;
    turn->is_over = false;
    cache->soonest = INT64_MAX;
}

/* Execute and record one instruction. Returns as `go_on`; *stops is set if the turn does not wait. */
static int32_t take_step(struct machine *machine, struct turn *turn, bool *stops)
{
    const struct known_answers *cache = &machine->answer_cache;
    struct node *node = next_node(machine);
    *stops = true;
    if (!node)
        return STOP_FAULT;
    if (node->marks || turn->step_count == MOST_STEPS || !keep_memory(machine, turn, &node->instruction))
        return -1;
    const uint64_t runs = node->runs, jumps = node->jumps;
    const int32_t reason = execute_from(machine, node, INT64_MIN);
    turn->steps[turn->step_count++] = (struct step){
        node, node->runs != runs ? &node->runs : node->jumps != jumps ? &node->jumps : &node->skips};
    *stops = machine->must_check || machine->core.sleeping || cache->era != turn->era || cache->asked != turn->asked;
    return reason;
}

/* Execute up to the beginning of the turn, or until a cycle. Returns as `go_on`. */
static int32_t execute_turn(struct machine *machine, struct turn *turn, int64_t until)
{
    const struct core *core = &machine->core;
    do {
        bool stops;
        const int32_t reason = take_step(machine, turn, &stops);
        if (stops || reason >= 0)
            return reason;
        if (core->cycles >= until || (core->r[15] == core->return_address && !core->delivers_faults))
            return -1;
    } while (core->r[15] != turn->core.r[15]);
    turn->is_over = true;
    return -1;
}

/* Return whether a turn has changed nothing but counts. */
static bool has_same_state(struct machine *machine, const struct turn *turn)
{
    const size_t first = offsetof(struct core, r), bytes = offsetof(struct core, deadline) - first;
    const struct history *now = &machine->history, *before = &turn->history;
    return memcmp((const char *)&machine->core + first, (const char *)&turn->core + first, bytes) == 0
        && memcmp(&now->pipeline, &before->pipeline, sizeof now->pipeline) == 0
        && memcmp(&now->stacks, &before->stacks, sizeof now->stacks) == 0
        && now->exclusive == before->exclusive && now->exclusive_address == before->exclusive_address
        && (!machine->waits || memcmp(machine->waits, &turn->waits, sizeof turn->waits) == 0)
        && has_same_memory(machine, turn);
}

/* -- many turns --------------------------------------------------------------------------------------------------- */

/* Repeat the answers of the last turn, so that the latest answers of all turns are stored. */
static void repeat_answers(struct machine *machine, int64_t loads, int64_t turns)
{
    struct core *core = &machine->core;
    uint32_t answers[ANSWERS];
    for (int64_t i = 0; i < loads; i++)
        answers[i] = machine->answers[(core->device_loads - loads + i) % ANSWERS];
    core->device_loads += loads * turns;
    const int64_t turns_kept = ANSWERS / loads + 1;
    int64_t number = core->device_loads - loads * (turns < turns_kept ? turns : turns_kept);
    for (int64_t i = 0; number < core->device_loads; number++, i = i + 1 == loads ? 0 : i + 1)
        machine->answers[number % ANSWERS] = answers[i];
}

static void count_turns(struct machine *machine, const struct turn *turn, int64_t turns)
{
    struct core *core = &machine->core;
    struct known_answers *cache = &machine->answer_cache;
    const int64_t instructions = core->instructions - turn->core.instructions;
    const int64_t loads = core->device_loads - turn->core.device_loads;
    if (machine->history.jumped_at > turn->core.instructions)
        machine->history.jumped_at += turns * instructions;
    core->instructions += turns * instructions;
    core->passed += turns * instructions;
    core->cycles += turns * (core->cycles - turn->core.cycles);
    core->memory_cycles += turns * (core->memory_cycles - turn->core.memory_cycles);
    core->address_cycles += turns * (core->address_cycles - turn->core.address_cycles);
    for (uint32_t i = 0; i < turn->step_count; i++)
        *turn->steps[i].count += (uint64_t)turns;
    for (int i = 0; i < KNOWN_ANSWERS; i++) {
        struct known_answer *entry = &cache->entries[i];
        if (entry->repeats == turn->repeats[i])
            continue;
        entry->repeats += turns * (entry->repeats - turn->repeats[i]);
        entry->repeated_at += turns * loads;
    }
    if (loads)
        repeat_answers(machine, loads, turns);
}

/* Return how many more turns end before anything can differ. */
static int64_t turns_until(const struct machine *machine, const struct turn *turn, int64_t until)
{
    const struct core *core = &machine->core;
    const int64_t end = machine->answer_cache.soonest < until ? machine->answer_cache.soonest : until;
    const int64_t period = core->cycles - turn->core.cycles;
    const bool fits = core->device_loads - turn->core.device_loads <= ANSWERS;
    return fits && period > 0 && end > core->cycles ? (end - core->cycles) / period : 0;
}

int32_t pass_turns(struct machine *machine, int64_t until, int32_t *patience, int32_t least)
{
    machine->answer_cache.polled = NULL;
    if (!machine->turn)
        machine->turn = malloc(sizeof *machine->turn);
    struct turn *turn = machine->turn;
    if (!turn || machine->profiles || machine->core.instruction_limit != INT64_MAX || code_is_full(machine))
        return -1;
    begin_turn(machine, turn);
    const int32_t reason = execute_turn(machine, turn, until);
    const bool is_wait = turn->is_over && has_same_state(machine, turn);
    const int64_t turns = is_wait ? turns_until(machine, turn, until) : 0;
    const bool is_cut_short = machine->must_check || machine->core.cycles >= until;
    if (turns) {
        count_turns(machine, turn, turns);
        *patience = least;
    } else if (!is_cut_short && *patience < MOST_PATIENCE && (!is_wait || machine->answer_cache.soonest < until)) {
        *patience *= 2; /* the attempt cost more than it saved */
    }
    return reason;
}

/* -- loops that poll memory --------------------------------------------------------------------------------------- */

/* Return whether an instruction may be part of a waiting loop: no store, no call, no indirect jump. */
static bool may_wait(const struct instruction *instruction)
{
    const bool jumps_far = instruction->transfer == TRANSFER_INDIRECT || instruction->operation == OP_BL;
    const bool stores = instruction->row == ROW_store || instruction->row == ROW_store_register_offset
        || instruction->row == ROW_fp_store || instruction->operation == OP_STM || instruction->operation == OP_STRD;
    return !jumps_far && !stores;
}

/* Return the branch that leads back to before a node, within a limited number of instructions; NULL if there is
 * none. */
static const struct node *closing_branch(const struct node *node)
{
    const uint32_t first = node->address;
    for (int32_t i = 0; i < MOST_INSTRUCTIONS && node && !node->marks && may_wait(&node->instruction); i++) {
        const struct instruction *instruction = &node->instruction;
        const bool branches = instruction->transfer == TRANSFER_DIRECT;
        if (branches && node->taken && node->taken->address <= first)
            return node;
        if (branches && !instruction->conditional)
            return NULL;
        node = node->next;
    }
    return NULL;
}

int32_t *patience_in_loop(struct machine *machine)
{
    const struct core *core = &machine->core;
    if (core->executes_all || (core->r[15] == core->return_address && !core->delivers_faults))
        return NULL;
    const struct node *node = next_node(machine), *end = node ? closing_branch(node) : NULL;
    if (!end)
        return NULL;
    struct short_loop *loop = &machine->short_loops[end->address / 2 % SHORT_LOOPS];
    if (loop->end != end->address)
        *loop = (struct short_loop){.end = end->address, .patience = LEAST_SAMPLES};
    if (++loop->samples < loop->patience)
        return NULL;
    loop->samples = 0;
    return &loop->patience;
}
