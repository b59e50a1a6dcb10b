/* The cycle model: the cost of an instruction after the instructions before it.
 *
 * "TRM" is the Arm Cortex-M4 technical reference manual; the profiles (profiles/ *.toml) name the source of each row.
 */
#include "prices.h"

#include <string.h>

#define ROW_NAME(NAME) #NAME,
static const char *const ROW_NAMES[PRICE_ROWS] = {COST_ROWS(ROW_NAME) RULE_ROWS(ROW_NAME)};

enum { LINK_REGISTER = 14 };
enum { DEAREST = 1000 }; /* largest value in a profile; sums stay far within 32 bits */

/* Rows that enable the rules of fetching and of addresses, all at once. */
static const uint8_t FETCH_ROWS[] = {
    ROW_address_use, ROW_address_use_fp, ROW_it_folded, ROW_it_skipped, ROW_target_misplaced, ROW_return_misplaced, ROW_fetch_late,
    ROW_fetch_late_fp, ROW_fetch_late_integer, ROW_fetch_late_access, ROW_fetch_late_unbroken,
};
enum { FETCH_ROW_COUNT = sizeof FETCH_ROWS / sizeof FETCH_ROWS[0] };

/* Possible causes of a late fetch, with rows for the delay. */
enum late { LATE_NOTHING, LATE_SLOW, LATE_FLOATING_POINT, LATE_INTEGER, LATE_ACCESS };
static const uint8_t LATE_ROWS[] = {0, ROW_fetch_late, ROW_fetch_late_fp, ROW_fetch_late_integer, ROW_fetch_late_access};
enum { MISPLACED_ON_END = 3 }; /* number of the instruction whose second half is late, unless a row says another */

/* States are compared as bytes, so they must not have padding, whose value is undefined. */
_Static_assert(
    sizeof(struct pipeline) == 4 * sizeof(uint8_t) + 2 * sizeof(bool) + 5 * sizeof(uint16_t) + 2 * sizeof(uint32_t),
    "struct pipeline has padding");

bool set_price(struct prices *prices, const char *row, int32_t value)
{
    if (value < 0 || value > DEAREST)
        return false;
    for (int i = 0; i < PRICE_ROWS; i++) {
        if (strcmp(ROW_NAMES[i], row) == 0) {
            prices->value[i] = value;
            prices->has[i] = true;
            return true;
        }
    }
    return false;
}

static bool has_fetch_rules(const struct prices *prices)
{
    bool has = false;
    for (int i = 0; i < FETCH_ROW_COUNT; i++)
        has |= prices->has[FETCH_ROWS[i]];
    return has;
}

static int32_t smaller(int32_t a, int32_t b) { return a < b ? a : b; }
static int32_t larger(int32_t a, int32_t b) { return a > b ? a : b; }

/* The core fetches words: four bytes at an address that is not a multiple of four are in two words. */
static bool is_misplaced(const struct instruction *instruction, uint32_t address)
{
    return instruction->size == 4 && address % 4 != 0;
}

/* --- The rules of every profile ----------------------------------------------------------------------------------- */

/* Cycles of a multiply-accumulate that overlap integer instructions; the cycle of its issue never does. */
static int32_t hidden_cycles(const struct prices *prices)
{
    return smaller(prices->value[ROW_fp_accumulate_hidden], larger(prices->value[ROW_fp_accumulate] - 1, 0));
}

/* A load overlaps the load right before unless it needs its result (TRM, 3.3.2), or both move the same base. A store
 * uses the second cycle of a load. */
bool overlaps_load(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    if (state->before != ROW_load)
        return false;
    if (instruction->row == ROW_store)
        return true;
    bool both_step = prices->value[ROW_load_same_base] && (state->stepped & instruction->stepped_base);
    return instruction->row == ROW_load && !(state->loaded & instruction->address_registers) && !both_step;
}

/* A store buffer that is not empty delays a load. */
static int32_t load_cycles(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    if (overlaps_load(prices, instruction, state))
        return prices->value[ROW_load_behind_load];
    int32_t late = state->before == ROW_store ? prices->value[ROW_load_behind_store] : 0;
    return prices->value[ROW_load] + late;
}

/* A store buffer that is not empty delays LDM, but not STM. */
static int32_t multiple_cycles(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    bool is_late = instruction->loads_multiple && state->before == ROW_store;
    int32_t late = is_late ? prices->value[ROW_multiple_behind_store] : 0;
    return prices->value[ROW_multiple_base] + instruction->words + late;
}

static bool is_multiply(uint8_t row) { return row >= ROW_multiply && row <= ROW_accumulate_long; }

/* Cycles of an instruction without waits. */
static int32_t own_cycles(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    switch (instruction->row) {
    case ROW_multiple_base: return multiple_cycles(prices, instruction, state);
    case ROW_fp_divide: return 1; /* the cycle of its issue; the FPU stays busy */
    case ROW_fp_accumulate: return prices->value[ROW_fp_accumulate] - hidden_cycles(prices);
    case ROW_load: return load_cycles(prices, instruction, state);
    case ROW_store: /* it uses the second cycle of a load */
        return prices->value[state->before == ROW_load ? ROW_store_behind_load : ROW_store];
    default:
        if (is_multiply(instruction->row) && !prices->has[instruction->row])
            return prices->value[ROW_data];
        return prices->value[instruction->row];
    }
}

/* Cycles that a floating-point instruction waits for the FPU and for its operands. */
static int32_t fpu_wait(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    if (state->divided & (instruction->fp_reads | instruction->fp_addend))
        return state->fpu_busy + prices->value[ROW_fp_divide_use] - prices->value[ROW_fp_divide];
    /* The addend of a multiply-accumulate is needed late, so nothing waits for it. */
    return state->fpu_busy + (state->fp_result & instruction->fp_reads ? prices->value[ROW_fp_use] : 0);
}

/* Return cycles in the format of `fpu_busy`. */
static uint16_t busy_cycles(int32_t cycles) { return (uint16_t)smaller(larger(cycles, 0), UINT16_MAX); }

static uint8_t single_access(uint8_t row)
{
    if (row == ROW_load)
        return ROW_load;
    return row == ROW_store || row == ROW_store_register_offset ? ROW_store : 0;
}

/* Set the state of the FPU after a floating-point instruction, which has waited for the previous one. */
static void leave_fpu(const struct prices *prices, const struct instruction *instruction, struct pipeline *after)
{
    if (instruction->row == ROW_fp_divide) {
        after->fpu_busy = busy_cycles(prices->value[ROW_fp_divide] - 1);
        after->divided = instruction->fp_writes;
    } else if (instruction->row == ROW_fp_accumulate) {
        after->fpu_busy = busy_cycles(hidden_cycles(prices));
        after->fp_result = instruction->fp_writes;
    } else if (instruction->row == ROW_fp) {
        after->fp_result = instruction->fp_writes;
    }
}

/* Set the state of the FPU after an integer instruction that took `cycles`. */
static void pass_fpu(const struct pipeline *state, int32_t cycles, struct pipeline *after)
{
    after->fpu_busy = busy_cycles(state->fpu_busy - cycles);
    /* The result is ready a cycle later than the FPU: it is recorded for the instruction at that cycle. */
    if (state->fpu_busy > 0 && state->fpu_busy >= cycles) {
        after->fp_result = state->fp_result;
        after->divided = state->divided;
    }
}

/* Price an instruction by the rows that every profile has. `after` and `state` must be different objects. */
static int32_t price_by_every_profile(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state,
    struct pipeline *after)
{
    int32_t wait = instruction->uses_fpu ? fpu_wait(prices, instruction, state) : 0;
    int32_t cycles = own_cycles(prices, instruction, state) + wait;
    *after = (struct pipeline){0};
    if (instruction->transfer != TRANSFER_NONE) /* it empties the pipeline, after any running division */
        return larger(cycles, state->fpu_busy);
    after->before = single_access(instruction->row);
    after->loaded = instruction->row == ROW_load ? instruction->loaded_registers : 0;
    after->stepped = prices->value[ROW_load_same_base] ? instruction->stepped_base : 0;
    if (instruction->uses_fpu)
        leave_fpu(prices, instruction, after);
    else
        pass_fpu(state, cycles, after);
    return cycles;
}

/* --- The rules of fetching and of addresses ----------------------------------------------------------------------- */

/* IT after an instruction of two bytes is folded onto it, and takes no time of its own (TRM, 3.3.1). */
static bool is_folded(const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    return prices->has[ROW_it_folded] && state->narrow && instruction->row == ROW_it;
}

/* No forwarding path leads from a result to the address of the next access (TRM, 3.3.2). */
static int32_t address_wait(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    if (!(state->computed & instruction->address_registers))
        return 0;
    return prices->value[state->computed_by_fpu ? ROW_address_use_fp : ROW_address_use];
}

static int32_t late_fetch(const struct prices *prices, uint8_t late)
{
    return late == LATE_NOTHING ? 0 : prices->value[LATE_ROWS[late]];
}

/* Return which of successive misaligned instructions is late: every second or every third. */
static int32_t misplaced_on_end(const struct prices *prices)
{
    return prices->has[ROW_misplaced_on_end] ? prices->value[ROW_misplaced_on_end] : MISPLACED_ON_END;
}

/* Cycles that a misplaced instruction waits for its second half. */
static int32_t fetch_wait(const struct prices *prices, const struct pipeline *state)
{
    int32_t late = state->misplaced == misplaced_on_end(prices) - 1 ? late_fetch(prices, state->late) : 0;
    if (state->reached == REACHED_BY_BRANCH)
        return late + prices->value[ROW_target_misplaced];
    if (state->reached == REACHED_BY_REGISTER)
        return late + prices->value[ROW_return_misplaced];
    return late;
}

/* Return the kind of an instruction of one cycle that begins a run of misplaced ones, or LATE_NOTHING. */
static uint8_t late_behind(const struct prices *prices, const struct instruction *instruction)
{
    if (prices->value[ROW_fetch_late_access] && single_access(instruction->row))
        return LATE_ACCESS;
    if (instruction->uses_fpu)
        return LATE_FLOATING_POINT;
    return prices->value[ROW_fetch_late_integer] ? LATE_INTEGER : LATE_NOTHING;
}

/* Set the state of fetching after an instruction that occupied the core for `cycles`. */
static void leave_fetch(
    const struct prices *prices, const struct instruction *instruction, bool misplaced, const struct pipeline *state,
    int32_t cycles, struct pipeline *after)
{
    uint8_t run = (uint8_t)(state->misplaced + 1);
    bool goes_on = state->late != LATE_NOTHING && misplaced && run < misplaced_on_end(prices);
    bool passes = state->late != LATE_NOTHING && instruction->size == 2 && prices->value[ROW_late_past_narrow];
    bool begins_anew = cycles >= 2 && !prices->value[ROW_fetch_late_unbroken];
    if (goes_on && !begins_anew) {
        after->late = state->late;
        after->misplaced = run;
    } else if (cycles >= 2) {
        after->late = LATE_SLOW;
    } else {
        after->late = late_behind(prices, instruction);
        if (passes && after->late == LATE_NOTHING) {
            after->late = state->late;
            after->misplaced = state->misplaced;
        }
    }
}

/* Return the registers that the next address may wait for. */
static uint16_t computed_registers(const struct prices *prices, const struct instruction *instruction)
{
    if (instruction->moves_from_fpu)
        return prices->value[ROW_address_use_fp] ? instruction->core_writes : 0;
    bool computes = instruction->row == ROW_data || instruction->row == ROW_divide || is_multiply(instruction->row);
    return computes && prices->value[ROW_address_use] ? instruction->core_writes : 0;
}

static int32_t price_by_all_rules(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *after)
{
    if (is_folded(prices, instruction, state)) {
        *after = *state;
        after->late = LATE_NOTHING;
        after->misplaced = 0;
        return prices->value[ROW_it_folded];
    }
    bool misplaced = is_misplaced(instruction, address);
    int32_t cycles = price_by_every_profile(prices, instruction, state, after);
    cycles += address_wait(prices, instruction, state);
    if (instruction->transfer != TRANSFER_NONE) {
        *after = pipeline_past(prices, instruction);
    } else {
        after->computed = computed_registers(prices, instruction);
        after->computed_by_fpu = after->computed && instruction->uses_fpu;
        after->narrow = prices->has[ROW_it_folded] && instruction->size == 2;
        leave_fetch(prices, instruction, misplaced, state, cycles, after);
    }
    return misplaced ? cycles + fetch_wait(prices, state) : cycles;
}

/* --- Interface ---------------------------------------------------------------------------------------------------- */

int32_t price_instruction(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *after)
{
    const struct pipeline before = *state; /* `after` may be the same object */
    if (has_fetch_rules(prices))
        return price_by_all_rules(prices, instruction, address, &before, after);
    return price_by_every_profile(prices, instruction, &before, after);
}

enum access_role access_role(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state)
{
    const bool is_behind_store = state->before == ROW_store;
    switch (instruction->row) {
    case ROW_load:
        if (overlaps_load(prices, instruction, state))
            return ACCESS_NONE;
        return is_behind_store ? ACCESS_BEHIND_STORE : ACCESS_BEGINS;
    case ROW_store: case ROW_store_register_offset:
        if (state->before == ROW_load)
            return ACCESS_NONE;
        return is_behind_store ? ACCESS_BEHIND_STORE : ACCESS_FIRST_STORE;
    case ROW_multiple_base:
        return is_behind_store && instruction->loads_multiple ? ACCESS_BEHIND_STORE : ACCESS_BEGINS;
    case ROW_exclusive: case ROW_fp_load: case ROW_fp_store: case ROW_table_branch: return ACCESS_BEGINS;
    default: return ACCESS_NONE;
    }
}

int32_t price_skipped(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *after)
{
    if (!prices->has[ROW_it_skipped])
        return price_instruction(prices, instruction, address, state, after);
    /* It is fetched and passes the pipeline, but accesses, reads and writes nothing. */
    const struct instruction skipped = {
        .row = ROW_it_skipped, .size = instruction->size, .transfer = instruction->transfer};
    return price_instruction(prices, &skipped, address, state, after);
}

struct pipeline pipeline_reached(enum reached reached)
{
    struct pipeline state = {0};
    if (reached == REACHED_PAST_BRANCH) /* after a branch of two bytes an IT may be folded onto it */
        state.narrow = true;
    else
        state.reached = (uint8_t)reached;
    return state;
}

/* Return how a transfer reaches its target, if that can matter. */
static enum reached reached_by(const struct prices *prices, const struct instruction *instruction)
{
    if (!has_fetch_rules(prices))
        return REACHED_ANYHOW;
    if (instruction->transfer != TRANSFER_DIRECT)
        return REACHED_BY_REGISTER;
    /* Targets at multiples of four are never misplaced: a common state avoids further prices. */
    return instruction->immediate % 4 ? REACHED_BY_BRANCH : REACHED_ANYHOW;
}

static enum rule_row refill_row(const struct prices *prices, const struct instruction *instruction)
{
    if (instruction->transfer == TRANSFER_DIRECT) {
        const bool is_call = instruction->core_writes & (1u << LINK_REGISTER); /* only BL writes it */
        return is_call && prices->has[ROW_refill_call] ? ROW_refill_call : ROW_refill_direct;
    }
    if (instruction->row == ROW_table_branch && prices->has[ROW_refill_table])
        return ROW_refill_table;
    if (instruction->row == ROW_load && prices->has[ROW_refill_load])
        return ROW_refill_load;
    if (instruction->row == ROW_multiple_base && prices->has[ROW_refill_multiple])
        return ROW_refill_multiple;
    return ROW_refill_indirect;
}

int32_t price_refill(const struct prices *prices, const struct instruction *instruction, struct pipeline *after)
{
    *after = pipeline_reached(reached_by(prices, instruction));
    return prices->value[refill_row(prices, instruction)];
}

struct pipeline pipeline_past(const struct prices *prices, const struct instruction *instruction)
{
    bool matters = has_fetch_rules(prices) && instruction->size == 2;
    return pipeline_reached(matters ? REACHED_PAST_BRANCH : REACHED_ANYHOW);
}
