/* The cycle model: the cost of an instruction after the instructions before it.
 *
 * The numbers are those of a timing profile (profiles/ *.toml); tests/virtual/price_model.py has the same rules.
 */
#ifndef HILTEST_PRICES_H
#define HILTEST_PRICES_H

#include "instruction.h"

/* Rows of a timing profile in addition to those of the instructions (enum cost_row). The last two are candidates of
 * hiltest.virtual.silicon.rule_candidates, which profile files cannot have. */
#define RULE_ROWS(X) \
    X(load_behind_load) X(load_same_base) X(load_behind_store) X(multiple_behind_store) X(store_behind_load) \
    X(fp_use) X(fp_divide_use) X(fp_accumulate_hidden) \
    X(refill_direct) X(refill_indirect) X(refill_table) X(refill_load) X(refill_call) X(refill_multiple) \
    X(exception_entry) X(exception_return) X(tail_chain) X(fp_frame) X(address_use) X(address_use_fp) X(it_folded) \
    X(target_misplaced) X(return_misplaced) X(fetch_late) X(fetch_late_fp) X(fetch_late_integer) X(fetch_late_access) \
    X(fetch_late_unbroken) X(unaligned) X(load_other_block) X(misplaced_on_end) X(late_past_narrow)
enum rule_row { FIRST_RULE_ROW = INSTRUCTION_ROWS - 1, RULE_ROWS(ROW_ENUMERATOR) PRICE_ROWS };

/* Values of all rows [clock cycles]. `has` marks the rows of the profile, because the rule of a missing row does not
 * apply. */
struct prices {
    int32_t value[PRICE_ROWS];
    bool has[PRICE_ROWS];
};

/* Set a row by its name. False, with no effect, if no row has that name or `value` is not from 0 to 1000. A zeroed
 * structure has no rows. */
bool set_price(struct prices *prices, const char *row, int32_t value);

/* Transition by which execution reached an instruction, if it affects the price. */
enum reached { REACHED_ANYHOW, REACHED_BY_BRANCH, REACHED_BY_REGISTER, REACHED_PAST_BRANCH };

/* Pipeline state that an instruction leaves for the next one. A zeroed structure is the neutral state. */
struct pipeline {
    uint8_t before;    /* ROW_load or ROW_store if the previous instruction is a single access, else 0 */
    uint8_t late;      /* enum late: possible cause of a late fetch */
    uint8_t misplaced; /* number of misaligned instructions of four bytes since then */
    uint8_t reached;   /* enum reached */
    bool narrow;       /* the previous instruction has two bytes */
    bool computed_by_fpu; /* a VMOV computed the registers of `computed` */
    uint16_t loaded;   /* core registers that the previous instruction loaded */
    uint16_t stepped;  /* base that it has moved, if it is a load */
    uint16_t computed; /* core registers that the previous instruction computed */
    uint16_t fpu_busy; /* cycles until the FPU is free */
    uint16_t unused;   /* always 0: states are compared as bytes, and padding would be undefined */
    uint32_t fp_result;/* s registers just computed, or ready when the FPU is free */
    uint32_t divided;  /* s registers with a division's result, ready one cycle later */
};

/* Return the state of an instruction that was reached by a branch. */
struct pipeline pipeline_reached(enum reached reached);

/* Price an instruction that executes and does not transfer control.
 *
 * Returns its cycles, including waits, and writes the resulting state to *after; `after` and `state` may be the
 * same object. `address` is the instruction's.
 */
int32_t price_instruction(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *after);

/* The same for an instruction that an IT block skips. Its price is the row it_skipped if the profile has it, otherwise
 * that of its execution. */
int32_t price_skipped(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *after);

/* Part of an instruction in a group of accesses to data without another instruction in between. */
enum access_role {
    ACCESS_NONE,         /* no access, or one that overlaps a load */
    ACCESS_BEGINS,       /* a load or a transfer of several words, which begin a group */
    ACCESS_FIRST_STORE,  /* a store that begins a group; the store buffer hides its wait */
    ACCESS_BEHIND_STORE, /* an access right behind a store of one word */
};
enum access_role access_role(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state);

/* Return whether a load or store overlaps the load right before it. */
bool overlaps_load(
    const struct prices *prices, const struct instruction *instruction, const struct pipeline *state);

/* Return the cycles that a taken transfer adds, and the state after it. */
int32_t price_refill(const struct prices *prices, const struct instruction *instruction, struct pipeline *after);

/* Return the state after a transfer that is not taken. */
struct pipeline pipeline_past(const struct prices *prices, const struct instruction *instruction);

#endif
