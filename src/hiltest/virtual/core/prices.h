/* The cycle model: what one instruction costs behind the ones before it.
 *
 * A timing profile (profiles/ *.toml) gives the numbers; tests/virtual/price_model.py has the same rules in Python.
 */
#ifndef HILTEST_PRICES_H
#define HILTEST_PRICES_H

#include "instruction.h"

/* Rows of a timing profile beside those of the instructions (enum cost_row), in the order of `RULE_ROWS`. The last two
 * are candidates of hiltest.virtual.silicon.rule_candidates, which no profile file may have. */
#define RULE_ROWS(X) \
    X(load_behind_load) X(load_behind_store) X(store_behind_load) X(fp_use) X(fp_divide_use) X(fp_accumulate_hidden) \
    X(refill_direct) X(refill_indirect) X(refill_table) X(refill_load) X(exception_entry) X(exception_return) \
    X(tail_chain) X(fp_frame) X(address_use) X(it_folded) X(target_misplaced) X(return_misplaced) X(fetch_late) \
    X(fetch_late_fp) X(fetch_late_integer) X(misplaced_on_end) X(late_past_narrow)
enum rule_row { FIRST_RULE_ROW = INSTRUCTION_ROWS - 1, RULE_ROWS(ROW_ENUMERATOR) PRICE_ROWS };

/* Values of all rows [clock cycles]; `has` says which rows the profile has, since a row that is missing is not the same
 * as one of zero cycles. */
struct prices {
    int32_t value[PRICE_ROWS];
    bool has[PRICE_ROWS];
};

/* Set a row by its name. False, and nothing is set, if no row has that name or `value` is not from 0 to 1000. All zero
 * are prices without any row. */
bool set_price(struct prices *prices, const char *row, int32_t value);

/* How execution came to an instruction, as far as the code before it does not tell. */
enum reached { REACHED_ANYHOW, REACHED_BY_BRANCH, REACHED_BY_REGISTER, REACHED_PAST_BRANCH };

/* What an instruction leaves for the next one. All zero is the neutral state. */
struct pipeline {
    uint8_t before;    /* 0, or ROW_load or ROW_store: the single access right before */
    uint8_t late;      /* what may make the fetch late: 0 nothing, 1 a slow, 2 a floating-point, 3 an integer instruction */
    uint8_t misplaced; /* instructions of four bytes, not at multiples of four, since then */
    uint8_t reached;   /* enum reached */
    bool narrow;       /* the instruction before has two bytes */
    uint8_t unused;    /* always 0: states are compared as bytes, and padding would have no defined value */
    uint16_t loaded;   /* core registers that the load right before wrote */
    uint16_t computed; /* core registers that the instruction right before computed */
    uint16_t fpu_busy; /* cycles until the FPU is free */
    uint32_t fp_result;/* s registers just computed, or computed when the FPU is free */
    uint32_t divided;  /* s registers that hold a division's result one cycle after that */
};

/* State behind a branch (reached in `enum reached`), by what led there. */
struct pipeline pipeline_reached(enum reached reached);

/* Price an instruction that executes and does not transfer control.
 *
 * Returns its cycles, waiting included, and writes the state that it leaves to *left; `left` and `state` may be the
 * same object. `address` is the instruction's.
 */
int32_t price_instruction(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *left);

/* The same for an instruction of an IT block that is skipped: by the row it_skipped if the profile has it, otherwise as
 * if it executed. */
int32_t price_skipped(
    const struct prices *prices, const struct instruction *instruction, uint32_t address,
    const struct pipeline *state, struct pipeline *left);

/* Cycles that are added when a transfer is taken, and the state behind it. */
int32_t price_refill(const struct prices *prices, const struct instruction *instruction, struct pipeline *left);

/* State behind a transfer that is not taken. */
struct pipeline pipeline_past(const struct prices *prices, const struct instruction *instruction);

#endif
