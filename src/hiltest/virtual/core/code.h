/* Decoded and priced instructions, linked in the order in which they execute.
 *
 * The cost of an instruction depends on the pipeline state that the previous one leaves. A node is an instruction after
 * one such state, so its price is computed only once. Its links lead to the nodes that can follow it.
 */
#ifndef HILTEST_CODE_H
#define HILTEST_CODE_H

#include "state.h"

/* Operations of execute.c in addition to those of instruction.h. */
enum {
    OP_IN_IT_BLOCK = OPERATIONS, /* check the condition, then do `instruction.operation` */
    OP_FPU_DISABLED,             /* a floating-point instruction while CPACR disables the FPU */
    OP_MARKED,                   /* at an address with marks, which are checked first */
    OP_FETCH_WAITS,              /* its fetch may wait for a memory */
    OP_READS_PC,                 /* needs the address of the instruction + 4 in r15 */
};

/* Marks of an address. */
enum mark {
    MARK_BREAKPOINT = 1,
    MARK_WATCHED = 2, /* calls_arrive is called before the instruction executes */
};

struct node {
    uint16_t operation; /* first action of the interpreter; mostly instruction.operation */
    bool moves_stack;   /* it writes r13 */
    uint8_t access;     /* enum access_role */
    bool fetch_waits;   /* its fetch may wait for a memory */
    bool overlaps_load; /* it loads or stores, and overlaps the load right before it */
    uint8_t marks;      /* enum mark */
    uint8_t it_state;   /* ITSTATE before the instruction */
    int32_t cost;       /* cycles if it executes and does not jump */
    int32_t taken_cost; /* if it jumps */
    int32_t skipped_cost;
    uint32_t address;
    uint32_t jump;      /* address of `taken` */
    struct instruction instruction;
    struct node *next, *taken, *skipped; /* NULL until the first execution */
    uint64_t runs, jumps, skips; /* executions without and with a jump, and skips; see counts.c */
    int64_t waited;     /* cycles that these executions waited for memories */
    uint16_t state;     /* numbers of the pipeline states before it, and after it */
    uint16_t next_state, taken_state, skipped_state;
    uint32_t path;      /* number in the profile that is being made, or 0 */
};

struct code *code_create(void);
void code_destroy(struct code *code);

/* Drop all nodes, because code or prices have changed, or because there are too many nodes. */
void code_forget(struct machine *machine);

uint32_t code_count(const struct machine *machine);
/* Return a node by its number; its code may have been changed. */
struct node *code_node(struct machine *machine, uint32_t number);

/* Return the node of the instruction at an address after a pipeline state; NULL if there is no memory at the address,
 * or if the host is out of memory. Nodes keep their addresses until `code_forget`. */
struct node *code_at(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state);

/* Return whether the nodes' memory is nearly full; `code_forget` must then be called while no caller uses a node. */
bool code_is_full(const struct machine *machine);

/* counts.c: move the counts of all nodes to the execution counts and to the profile, if either is wanted. */
void counts_fold(struct machine *machine);
/* Set the counts of all nodes to zero. */
void counts_drop(struct machine *machine);
/* Count an instruction that has faulted. */
void counts_fault(struct machine *machine, uint32_t address);

/* profile.c: while a profile is made, record that execution continues from a node at an address, with a jump or
 * without. Returns whether this transition always stays on the path, so that the nodes may be linked. */
bool profile_follow(struct machine *machine, const struct node *from, uint32_t target, bool jumps);
/* Add the counts of a node to the profile. */
void profile_add(struct machine *machine, const struct node *node);
void profile_destroy(struct machine *machine);

/* Price nodes by `count` tables, including the machine's own, and drop all nodes. False if out of memory. */
enum { MOST_TABLES = 128 };
bool code_set_tables(struct machine *machine, uint32_t count);
/* Add the cycles of all nodes' counts to `totals`, which has one entry for each table. */
void code_add_cycles(struct machine *machine, int64_t *totals);

/* Return the number of a pipeline state; with several price tables, of an array with one state for each. */
uint16_t code_state_number(struct machine *machine, const struct pipeline *pipelines);
const struct pipeline *code_state(const struct machine *machine, uint16_t number);
/* Return the number of the state before the next instruction. */
uint16_t code_next_state(struct machine *machine);

/* Set or clear a mark of an address. False if there are too many marked addresses. */
bool code_set_mark(struct machine *machine, uint32_t address, enum mark mark, bool set);

#endif
