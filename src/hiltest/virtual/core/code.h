/* Decoded and priced instructions, linked in the order in which they execute.
 *
 * What an instruction costs depends on the pipeline that the one before it leaves. A node is an instruction behind one
 * such state, so its price is computed once; it leads to the nodes that can follow it.
 */
#ifndef HILTEST_CODE_H
#define HILTEST_CODE_H

#include "state.h"

/* Operations that execute.c knows beside those of instruction.h. */
enum {
    OP_IN_IT_BLOCK = OPERATIONS, /* look at the condition, then do what `instruction.operation` says */
    OP_FPU_DISABLED,             /* a floating-point instruction while CPACR disables the FPU */
    OP_MARKED,                   /* at an address with marks: look at them first */
    OP_READS_PC,                 /* r15 has to be the address of the instruction + 4 */
};

/* What is special about an address. */
enum mark {
    MARK_BREAKPOINT = 1,
    MARK_WATCHED = 2, /* calls_arrive is called before the instruction executes */
};

struct node {
    uint16_t operation; /* what the executor does first; the same as instruction.operation for most */
    bool moves_stack;   /* it writes r13 */
    uint8_t marks;      /* enum mark */
    uint8_t it_state;   /* ITSTATE before it */
    int32_t cost;       /* cycles if it executes and does not jump */
    int32_t taken_cost; /* if it jumps */
    int32_t skipped_cost;
    uint32_t address;
    uint32_t jump;      /* address that `taken` is of */
    struct instruction instruction;
    struct node *next, *taken, *skipped; /* NULL until execution goes there */
    uint64_t runs, jumps, skips; /* how often it executed and went on, jumped, and was skipped; see counts.c */
    uint16_t state;     /* numbers of the pipeline states before it and behind it */
    uint16_t left, left_taken, left_skipped;
    uint32_t path;      /* of the profile that is being made, or 0 */
};

struct code *code_create(void);
void code_destroy(struct code *code);

/* Drop all nodes: code or prices have changed, or there are too many. */
void code_forget(struct machine *machine);

uint32_t code_count(const struct machine *machine);
/* Return a node by its number; it may stand for code that has been changed. */
struct node *code_node(struct machine *machine, uint32_t number);

/* Return the node of the instruction at an address, behind the pipeline state that is numbered. NULL if there is no
 * memory; *first_missing is the address then. Nodes stay where they are until `code_forget`. */
struct node *code_at(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state);

/* Whether so many nodes exist that `code_forget` should be called, at a moment when nobody holds one. */
bool code_is_full(const struct machine *machine);

/* counts.c: keep the counts of all nodes, and set them to zero, if somebody watches executions or makes a profile. */
void counts_fold(struct machine *machine);
void counts_drop(struct machine *machine);
/* Count an instruction that has faulted. */
void counts_fault(struct machine *machine, uint32_t address);

/* profile.c: while a profile is made, execution goes from a node to an address, by a jump or behind it. Returns whether
 * it always does so without leaving the path, so that the nodes may be linked. */
bool profile_follows(struct machine *machine, const struct node *from, uint32_t target, bool jumps);
/* Add the counts of a node. */
void profile_add(struct machine *machine, const struct node *node);
void profile_destroy(struct machine *machine);

/* Price nodes by so many tables, the machine's own included. Drops all nodes. False if there is no memory. */
enum { MOST_TABLES = 128 };
bool code_set_tables(struct machine *machine, uint32_t count);
/* Add to totals, one for each table, the cycles of all that the nodes have counted. */
void code_add_cycles(struct machine *machine, int64_t *totals);

/* Number of a pipeline state; with several tables of one for each of them. */
uint16_t code_state_number(struct machine *machine, const struct pipeline *pipelines);
const struct pipeline *code_state(const struct machine *machine, uint16_t number);
/* Number of the state that the next instruction finds. */
uint16_t code_next_state(struct machine *machine);

/* Mark an address, or take a mark away. False if there are too many marked addresses. */
bool code_set_mark(struct machine *machine, uint32_t address, enum mark mark, bool set);

#endif
