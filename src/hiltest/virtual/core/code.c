#include "code.h"

#include <stdlib.h>
#include <string.h>

enum {
    CHUNK = 4096,        /* nodes per allocation */
    CHUNKS = 64,
    SPARE = 64,          /* nodes that can still be made when code_is_full returns true */
    FIRST_BUCKETS = 1 << 12, /* a power of two; there are always twice as many as nodes */
    STATES = 1 << 14,
    STATE_BUCKETS = 2 * STATES,
    MARKED = 1 << 14,
};

struct bucket {
    uint32_t generation; /* the bucket is empty if this differs from the code's */
    struct node *node;
};

struct marked {
    uint32_t address;
    bool is_used;
    uint8_t marks;
};

/* Cycles of a node's instruction, by another price table. */
struct cost {
    int32_t runs, jumps, skips;
};

struct code {
    struct node *chunks[CHUNKS];
    struct cost *costs[CHUNKS]; /* by chunk: for each node, for each table but the first */
    uint32_t table_count;
    uint32_t count;
    uint32_t generation;
    struct bucket *buckets;
    uint32_t bucket_count;
    struct pipeline *states; /* each is an array with one state for each table */
    uint16_t state_buckets[STATE_BUCKETS]; /* number of a state + 1, or 0 */
    uint32_t state_count;
    struct marked marked[MARKED];
};

struct code *code_create(void)
{
    struct code *code = calloc(1, sizeof *code);
    if (!code)
        return NULL;
    code->buckets = calloc(FIRST_BUCKETS, sizeof *code->buckets);
    code->bucket_count = FIRST_BUCKETS;
    code->states = calloc(STATES, sizeof *code->states);
    if (!code->buckets || !code->states) {
        code_destroy(code);
        return NULL;
    }
    code->generation = code->table_count = 1;
    return code;
}

void code_destroy(struct code *code)
{
    if (!code)
        return;
    for (int i = 0; i < CHUNKS; i++) {
        free(code->chunks[i]);
        free(code->costs[i]);
    }
    free(code->states);
    free(code->buckets);
    free(code);
}

void code_forget(struct machine *machine)
{
    struct code *code = machine->code;
    machine->code_changed = false;
    if (!code->count)
        return;
    counts_fold(machine);
    code->count = 0;
    code->state_count = 0;
    machine->standing = UINT16_MAX;
    memset(code->state_buckets, 0, sizeof code->state_buckets);
    if (++code->generation == 0) { /* after a wrap-around, old buckets would be valid again */
        memset(code->buckets, 0, code->bucket_count * sizeof *code->buckets);
        code->generation = 1;
    }
    unmark_code(machine);
}

bool code_is_full(const struct machine *machine)
{
    const struct code *code = machine->code;
    return code->count + SPARE > CHUNK * CHUNKS || code->count + SPARE > code->bucket_count
        || code->state_count + SPARE > STATES;
}

/* -- pipeline states --------------------------------------------------------------------------------------------- */

static uint32_t mix(uint32_t hash, uint32_t value)
{
    hash = (hash ^ value) * 0x9E3779B1u;
    return hash ^ hash >> 15;
}

static uint32_t hash_of_bytes(const void *bytes, size_t size)
{
    uint32_t hash = 0;
    for (size_t i = 0; i + 4 <= size; i += 4) {
        uint32_t word;
        memcpy(&word, (const char *)bytes + i, 4);
        hash = mix(hash, word);
    }
    return hash;
}

uint16_t code_state_number(struct machine *machine, const struct pipeline *pipelines)
{
    struct code *code = machine->code;
    const size_t bytes = code->table_count * sizeof *pipelines;
    uint32_t place = hash_of_bytes(pipelines, bytes) % STATE_BUCKETS;
    while (code->state_buckets[place]) {
        uint16_t number = (uint16_t)(code->state_buckets[place] - 1);
        if (memcmp(code_state(machine, number), pipelines, bytes) == 0)
            return number;
        place = (place + 1) % STATE_BUCKETS;
    }
    uint16_t number = (uint16_t)code->state_count++;
    memcpy(&code->states[number * code->table_count], pipelines, bytes);
    code->state_buckets[place] = (uint16_t)(number + 1);
    return number;
}

const struct pipeline *code_state(const struct machine *machine, uint16_t number)
{
    return &machine->code->states[number * machine->code->table_count];
}

uint16_t code_next_state(struct machine *machine)
{
    const struct code *code = machine->code;
    const uint16_t standing = machine->standing;
    if (standing < code->state_count
        && memcmp(code_state(machine, standing), &machine->history.pipeline, sizeof machine->history.pipeline) == 0)
        return standing;
    struct pipeline pipelines[MOST_TABLES];
    for (uint32_t table = 0; table < code->table_count; table++)
        pipelines[table] = machine->history.pipeline;
    return code_state_number(machine, pipelines);
}

/* -- marks ------------------------------------------------------------------------------------------------------- */

/* Return the entry of an address, or the free entry for it; NULL if the table is full. */
static struct marked *marked_at(struct code *code, uint32_t address)
{
    uint32_t place = mix(0, address) % MARKED;
    for (uint32_t i = 0; i < MARKED; i++) {
        struct marked *entry = &code->marked[(place + i) % MARKED];
        if (!entry->is_used || entry->address == address)
            return entry;
    }
    return NULL;
}

static uint8_t marks_at(struct code *code, uint32_t address)
{
    const struct marked *entry = marked_at(code, address);
    return entry && entry->is_used ? entry->marks : 0;
}

/* -- nodes ------------------------------------------------------------------------------------------------------- */

static struct node *new_node(struct code *code)
{
    uint32_t chunk = code->count / CHUNK;
    if (chunk >= CHUNKS)
        return NULL;
    if (!code->chunks[chunk]) {
        code->chunks[chunk] = malloc(CHUNK * sizeof(struct node));
        if (!code->chunks[chunk])
            return NULL;
    }
    if (code->table_count > 1 && !code->costs[chunk]) {
        code->costs[chunk] = malloc(CHUNK * (code->table_count - 1) * sizeof(struct cost));
        if (!code->costs[chunk])
            return NULL;
    }
    struct node *node = &code->chunks[chunk][code->count++ % CHUNK];
    memset(node, 0, sizeof *node);
    return node;
}

static uint16_t first_operation(const struct machine *machine, const struct node *node)
{
    const struct instruction *instruction = &node->instruction;
    if (node->marks)
        return OP_MARKED;
    if (instruction->in_it_block)
        return OP_IN_IT_BLOCK;
    if (instruction->uses_fpu && !machine->core.fpu_enabled)
        return OP_FPU_DISABLED;
    if (node->fetch_waits)
        return OP_FETCH_WAITS;
    bool reads_pc = instruction->n == 15 || instruction->m == 15;
    return reads_pc && !instruction->uses_fpu ? OP_READS_PC : instruction->operation;
}

uint32_t code_count(const struct machine *machine) { return machine->code->count; }

struct node *code_node(struct machine *machine, uint32_t number)
{
    return &machine->code->chunks[number / CHUNK][number % CHUNK];
}

/* Mark existing nodes in place, because a debugger sets and clears the same marks over and over. */
static void mark_nodes(struct machine *machine, uint32_t address, uint8_t marks)
{
    for (uint32_t i = 0; i < code_count(machine); i++) {
        struct node *node = code_node(machine, i);
        if (node->address == address) {
            node->marks = marks;
            node->operation = first_operation(machine, node);
        }
    }
}

bool code_set_mark(struct machine *machine, uint32_t address, enum mark mark, bool set)
{
    struct marked *entry = marked_at(machine->code, address);
    if (!entry)
        return false;
    entry->is_used = true; /* permanently, because the search for later entries passes this one */
    entry->address = address;
    uint8_t marks = (uint8_t)(set ? entry->marks | mark : entry->marks & ~mark);
    if (marks != entry->marks)
        mark_nodes(machine, address, marks);
    entry->marks = marks;
    return true;
}

/* States after an instruction, by table. */
struct states_after {
    struct pipeline next[MOST_TABLES], taken[MOST_TABLES], skipped[MOST_TABLES];
};

/* Price an instruction by one table. */
static struct cost price(
    const struct prices *prices, const struct node *node, const struct pipeline *before, uint32_t table,
    struct states_after *after)
{
    const struct instruction *instruction = &node->instruction;
    struct cost cost = {0};
    cost.runs = price_instruction(prices, instruction, node->address, before, &after->next[table]);
    if (instruction->transfer) {
        cost.jumps = cost.runs + price_refill(prices, instruction, &after->taken[table]);
        after->next[table] = pipeline_past(prices, instruction);
    }
    if (instruction->in_it_block) {
        cost.skips = price_skipped(prices, instruction, node->address, before, &after->skipped[table]);
        if (instruction->transfer)
            after->skipped[table] = pipeline_past(prices, instruction);
    }
    return cost;
}

static struct cost *costs_of(struct code *code, uint32_t number)
{
    return &code->costs[number / CHUNK][number % CHUNK * (code->table_count - 1)];
}

/* Price the newest node. */
static void price_node(struct machine *machine, struct node *node)
{
    struct code *code = machine->code;
    const struct pipeline *before = code_state(machine, node->state);
    struct states_after after;
    const struct cost cost = price(&machine->prices, node, before, 0, &after);
    node->access = (uint8_t)access_role(&machine->prices, &node->instruction, before);
    node->overlaps_load = overlaps_load(&machine->prices, &node->instruction, before);
    node->cost = cost.runs;
    node->taken_cost = cost.jumps;
    node->skipped_cost = cost.skips;
    for (uint32_t table = 1; table < code->table_count; table++)
        costs_of(code, code->count - 1)[table - 1] =
            price(&machine->tables[table - 1], node, before + table, table, &after);
    node->next_state = code_state_number(machine, after.next);
    if (node->instruction.transfer)
        node->taken_state = code_state_number(machine, after.taken);
    if (node->instruction.in_it_block)
        node->skipped_state = code_state_number(machine, after.skipped);
}

static struct node *make_node(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state)
{
    uint16_t first, second = 0;
    if (!fetch(machine, address, &first))
        return NULL;
    if (instruction_size(first) == 4 && !fetch(machine, address + 2, &second))
        return NULL;
    struct node *node = new_node(machine->code);
    if (!node)
        return NULL;
    node->address = address;
    node->it_state = it_state;
    node->state = state;
    node->path = machine->path;
    decode_instruction(address, first, second, it_state, machine->baseline, &node->instruction);
    if (node->instruction.operation == OP_BKPT)
        node->instruction.condition = CONDITION_ALWAYS; /* even in an IT block, see BKPT */
    node->moves_stack = node->instruction.core_writes >> 13 & 1 || node->instruction.sets_stack;
    node->marks = marks_at(machine->code, address);
    node->fetch_waits = machine->waits && fetches_wait(machine->waits, node->address);
    node->operation = first_operation(machine, node);
    price_node(machine, node);
    mark_code(machine, address, node->instruction.size);
    return node;
}

static uint32_t hash_of_node(uint32_t path, uint32_t address, uint8_t it_state, uint16_t state)
{
    return mix(mix(path, address), (uint32_t)it_state << 16 | state);
}

static void insert_node(struct code *code, struct node *node)
{
    uint32_t place = hash_of_node(node->path, node->address, node->it_state, node->state) % code->bucket_count;
    while (code->buckets[place].generation == code->generation)
        place = (place + 1) % code->bucket_count;
    code->buckets[place] = (struct bucket){code->generation, node};
}

/* Double the buckets; if out of memory, keep them until `code_is_full` returns true. */
static void add_buckets(struct code *code)
{
    struct bucket *buckets = calloc(2 * (size_t)code->bucket_count, sizeof *buckets);
    if (!buckets)
        return;
    free(code->buckets);
    code->buckets = buckets;
    code->bucket_count *= 2;
    for (uint32_t i = 0; i + 1 < code->count; i++) /* the last node is not inserted yet */
        insert_node(code, &code->chunks[i / CHUNK][i % CHUNK]);
}

struct node *code_at(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state)
{
    struct code *code = machine->code;
    uint32_t place = hash_of_node(machine->path, address, it_state, state) % code->bucket_count;
    while (code->buckets[place].generation == code->generation) {
        struct node *node = code->buckets[place].node;
        if (node->address == address && node->it_state == it_state && node->state == state
            && node->path == machine->path)
            return node;
        place = (place + 1) % code->bucket_count;
    }
    struct node *node = make_node(machine, address, it_state, state);
    if (!node)
        return NULL;
    if (2 * code->count > code->bucket_count)
        add_buckets(code);
    insert_node(code, node);
    return node;
}

/* -- several tables ---------------------------------------------------------------------------------------------- */

bool code_set_tables(struct machine *machine, uint32_t count)
{
    struct code *code = machine->code;
    if (count < 1 || count > MOST_TABLES)
        return false;
    struct pipeline *states = calloc((size_t)STATES * count, sizeof *states);
    if (!states)
        return false;
    code_forget(machine);
    for (int i = 0; i < CHUNKS; i++) {
        free(code->costs[i]);
        code->costs[i] = NULL;
    }
    free(code->states);
    code->states = states;
    code->table_count = count;
    return true;
}

static int64_t cycles_of(const struct node *node, struct cost cost)
{
    return (int64_t)node->runs * cost.runs + (int64_t)node->jumps * cost.jumps + (int64_t)node->skips * cost.skips;
}

void code_add_cycles(struct machine *machine, int64_t *totals)
{
    struct code *code = machine->code;
    for (uint32_t number = 0; number < code->count; number++) {
        const struct node *node = code_node(machine, number);
        if (!(node->runs | node->jumps | node->skips))
            continue;
        totals[0] += cycles_of(node, (struct cost){node->cost, node->taken_cost, node->skipped_cost});
        for (uint32_t table = 1; table < code->table_count; table++)
            totals[table] += cycles_of(node, costs_of(code, number)[table - 1]);
    }
}
