/* Profiles: the cost of each instruction and its causes, along each path of calls.
 *
 * While a profile is made, nodes belong to the path on which they are executed, so that their counts are the path's.
 * Paths follow the transfers between nodes: BL and BLX call; an indirect transfer to the return address of a call
 * returns; other code that is jumped to, or reached without a jump, is a function under the one that leads to it.
 * Inlined code is part of the function that it was inlined into. A recursive function stays one path.
 */
#include <stdlib.h>
#include <string.h>

#include "code.h"

enum {
    LINK_REGISTER = 14, STACK_POINTER = 13,
    DEEPEST = 100,       /* beyond this depth, an indirectly recursive function continues on its own earlier path */
    ROOT = 1,            /* the path of the called function; 0 is no path */
    MOST_FRAMES = 1 << 20, MOST_PATHS = 1 << 20, MOST_COSTS = 1 << 24,
    FIRST_ROOM = 1024,
};
static const uint32_t NO_FUNCTION = UINT32_MAX;
#define ROW_NAME(NAME) #NAME,
static const char *const ROW_NAMES[INSTRUCTION_ROWS] = {COST_ROWS(ROW_NAME)};

/* An open call: its return address, stack pointer and function. */
struct frame {
    uint32_t return_address, stack_pointer;
    uint32_t caller, entered;
};

struct path {
    struct machine_path shown;
    uint32_t depth, first_callee, next_callee;
};

struct profile {
    struct machine_code_range *code;
    uint32_t code_count;
    struct path *paths;
    uint32_t path_count, path_room;
    struct frame *frames;
    uint32_t frame_count, frame_room;
    struct machine_cost *costs;
    uint32_t cost_count, cost_room;
    int64_t idle_cycles; /* of the machine, up to which they were assigned to paths */
    bool is_short;   /* of memory */
};

/* -- memory ------------------------------------------------------------------------------------------------------- */

/* Return an array with room for one more element. Without room the profile is short of memory and *room is not
 * larger than `count`. */
static void *with_room(
    struct profile *profile, void *elements, uint32_t *room, uint32_t count, size_t size, uint32_t most)
{
    if (count < *room)
        return elements;
    uint32_t larger = *room ? 2 * *room : FIRST_ROOM;
    void *moved = larger <= most ? realloc(elements, larger * size) : NULL;
    if (!moved) {
        profile->is_short = true;
        return elements;
    }
    *room = larger;
    return moved;
}

void profile_destroy(struct machine *machine)
{
    struct profile *profile = machine->profile;
    machine->profile = NULL;
    machine->profiles = false;
    if (!profile)
        return;
    free(profile->code);
    free(profile->paths);
    free(profile->frames);
    free(profile->costs);
    free(profile);
}

/* -- paths -------------------------------------------------------------------------------------------------------- */

static uint32_t add_path(struct profile *profile, uint32_t function, uint32_t caller)
{
    uint32_t number = profile->path_count;
    profile->paths = with_room(
        profile, profile->paths, &profile->path_room, number, sizeof *profile->paths, MOST_PATHS);
    if (number == profile->path_room)
        return ROOT;
    profile->path_count++;
    struct path *path = &profile->paths[number], *above = &profile->paths[caller];
    memset(path, 0, sizeof *path);
    path->shown.function = function;
    path->shown.caller = caller;
    if (caller) {
        path->depth = above->depth + 1;
        path->next_callee = above->first_callee;
        above->first_callee = number;
    }
    return number;
}

static uint32_t function_of(const struct profile *profile, uint32_t path)
{
    return profile->paths[path].shown.function;
}

/* Return the start of the function that an address belongs to. */
static uint32_t owner_of(const struct profile *profile, uint32_t address)
{
    uint32_t low = 0, high = profile->code_count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (profile->code[middle].begin <= address)
            low = middle + 1;
        else
            high = middle;
    }
    const struct machine_code_range *code = low ? &profile->code[low - 1] : NULL;
    return code && address < code->end ? code->function : NO_FUNCTION;
}

/* Return the path of a function that is reached from another path. */
static uint32_t path_to(struct profile *profile, uint32_t path, uint32_t function)
{
    if (function_of(profile, path) == function)
        return path;
    uint32_t callee = profile->paths[path].first_callee;
    while (callee && function_of(profile, callee) != function)
        callee = profile->paths[callee].next_callee;
    if (callee)
        return callee;
    uint32_t above = profile->paths[path].depth >= DEEPEST ? path : 0;
    while (above && function_of(profile, above) != function)
        above = profile->paths[above].shown.caller;
    return above ? above : add_path(profile, function, path);
}

static void enter_call(struct machine *machine, uint32_t target, uint32_t return_address)
{
    struct profile *profile = machine->profile;
    uint32_t owner = owner_of(profile, target), caller = machine->path;
    machine->path = path_to(profile, caller, owner == NO_FUNCTION ? target : owner);
    profile->paths[machine->path].shown.entries++;
    profile->frames = with_room(
        profile, profile->frames, &profile->frame_room, profile->frame_count, sizeof *profile->frames, MOST_FRAMES);
    if (profile->frame_count < profile->frame_room)
        profile->frames[profile->frame_count++] =
            (struct frame){return_address, machine->core.r[STACK_POINTER], caller, machine->path};
}

/* Leave the innermost call with a return address; false if there is none. */
static bool leave_call(struct machine *machine, uint32_t target)
{
    struct profile *profile = machine->profile;
    for (uint32_t i = profile->frame_count; i-- > 0;) {
        const struct frame *frame = &profile->frames[i];
        /* A lower stack pointer than at the call belongs to a jump within a deeper recursion, not to a return. */
        if (frame->return_address == target && machine->core.r[STACK_POINTER] >= frame->stack_pointer) {
            machine->path = frame->caller;
            profile->frame_count = i;
            return true;
        }
    }
    return false;
}

/* Return a function that has jumped away since the last call: returning to it must not lengthen the path. */
static uint32_t left_by_tail_call(const struct machine *machine, uint32_t function)
{
    const struct profile *profile = machine->profile;
    uint32_t outermost = profile->frame_count ? profile->frames[profile->frame_count - 1].entered : ROOT;
    uint32_t path = machine->path;
    while (path != outermost && profile->paths[path].shown.caller) {
        path = profile->paths[path].shown.caller;
        if (function_of(profile, path) == function)
            return path;
    }
    return 0;
}

/* Continue in the same function, or in another one after a jump; false if it is another one. */
static bool stay(struct machine *machine, uint32_t target)
{
    struct profile *profile = machine->profile;
    uint32_t owner = owner_of(profile, target);
    if (owner == NO_FUNCTION || owner == function_of(profile, machine->path))
        return true;
    uint32_t path = left_by_tail_call(machine, owner);
    machine->path = path ? path : path_to(profile, machine->path, owner);
    profile->paths[machine->path].shown.entries += target == owner;
    return false;
}

/* Assign the sleep since the last change of the path to the present path. */
static void settle_sleep(struct machine *machine)
{
    struct profile *profile = machine->profile;
    profile->paths[machine->path].shown.idle_cycles += machine->core.idle_cycles - profile->idle_cycles;
    profile->idle_cycles = machine->core.idle_cycles;
}

bool profile_follow(struct machine *machine, const struct node *from, uint32_t target, bool jumps)
{
    const struct instruction *instruction = &from->instruction;
    settle_sleep(machine);
    if (!jumps)
        return stay(machine, target);
    if (instruction->core_writes >> LINK_REGISTER & 1) {
        enter_call(machine, target, from->address + instruction->size);
        return false;
    }
    if (instruction->transfer != TRANSFER_INDIRECT)
        return stay(machine, target);
    if (!leave_call(machine, target))
        stay(machine, target);
    return false;
}

/* -- costs -------------------------------------------------------------------------------------------------------- */

/* Return the sums of a node; NULL if out of memory. */
static struct machine_cost *new_cost(struct profile *profile, uint32_t path, uint32_t address, int32_t row)
{
    profile->costs = with_room(
        profile, profile->costs, &profile->cost_room, profile->cost_count, sizeof *profile->costs, MOST_COSTS);
    if (profile->is_short)
        return NULL;
    struct machine_cost *cost = &profile->costs[profile->cost_count++];
    *cost = (struct machine_cost){.path = path, .address = address, .row = row};
    return cost;
}

/* Remove one possible cause of waits from a pipeline's state. */
static void take_away(struct pipeline *state, enum machine_stall stall)
{
    switch (stall) {
    case STALL_FETCH: state->late = state->misplaced = 0; state->reached = REACHED_ANYHOW; break;
    case STALL_ADDRESS: state->computed = 0; break;
    case STALL_DIVISION: state->fpu_busy = 0; state->divided = 0; break;
    case STALL_FP_RESULT: state->fp_result = 0; break;
    case STALL_LOAD_USE: state->loaded = 0; break;
    case STALL_STORE_BUFFER: state->before = state->before == ROW_store ? 0 : state->before; break;
    default: break;
    }
}

/* Add the cost of some executions of a node that do not jump, or are skipped. The work is the cost without any cause
 * of waits, so that the parts always add up to the whole. */
static void add_cost(
    const struct machine *machine, const struct node *node, bool is_skipped, uint64_t times, struct machine_cost *cost)
{
    int32_t (*price)(
        const struct prices *, const struct instruction *, uint32_t, const struct pipeline *, struct pipeline *) =
        is_skipped ? price_skipped : price_instruction;
    struct pipeline state = *code_state(machine, node->state), after;
    int32_t cycles = price(&machine->prices, &node->instruction, node->address, &state, &after);
    for (int stall = 0; stall < STALL_TAKEN_BRANCH; stall++) {
        take_away(&state, (enum machine_stall)stall);
        int32_t less = price(&machine->prices, &node->instruction, node->address, &state, &after);
        if (less < cycles) {
            cost->stall_cycles[stall] += times * (uint64_t)(cycles - less);
            cycles = less;
        }
    }
    cost->executions += times;
    cost->work_cycles += times * (uint64_t)cycles;
}

void profile_add(struct machine *machine, const struct node *node)
{
    const struct instruction *instruction = &node->instruction;
    struct profile *profile = machine->profile;
    if (node->runs || node->jumps) {
        struct machine_cost *cost = new_cost(profile, node->path, node->address, instruction->row);
        if (!cost)
            return;
        add_cost(machine, node, false, node->runs + node->jumps, cost);
        cost->jumps += node->jumps;
        cost->wait_cycles += node->waited;
        cost->stall_cycles[STALL_TAKEN_BRANCH] += node->jumps * (uint64_t)(node->taken_cost - node->cost);
    }
    if (node->skips) {
        int32_t row = machine->prices.has[ROW_it_skipped] ? ROW_it_skipped : instruction->row;
        struct machine_cost *cost = new_cost(profile, node->path, node->address, row);
        if (cost)
            add_cost(machine, node, true, node->skips, cost);
    }
}

/* -- interface ---------------------------------------------------------------------------------------------------- */

bool machine_begin_profile(
    struct machine *machine, uint32_t function, const struct machine_code_range *code, uint32_t count)
{
    machine_end_profile(machine);
    profile_destroy(machine);
    code_forget(machine);
    struct profile *profile = calloc(1, sizeof *profile);
    if (!profile)
        return false;
    machine->profile = profile;
    profile->code = malloc((count ? count : 1) * sizeof *profile->code);
    if (!profile->code || add_path(profile, NO_FUNCTION, 0) != 0 || add_path(profile, function, 0) != ROOT) {
        profile_destroy(machine);
        return false;
    }
    memcpy(profile->code, code, count * sizeof *code);
    profile->code_count = count;
    profile->paths[ROOT].shown.entries = 1;
    profile->idle_cycles = machine->core.idle_cycles;
    machine->path = ROOT;
    machine->profiles = true;
    return true;
}

bool machine_end_profile(struct machine *machine)
{
    if (!machine->profiles)
        return false;
    settle_sleep(machine);
    code_forget(machine);
    machine->profiles = false;
    machine->path = 0;
    return !machine->profile->is_short;
}

const struct machine_path *machine_path(struct machine *machine, uint32_t number)
{
    return machine->profile && number && number < machine->profile->path_count
        ? &machine->profile->paths[number].shown : NULL;
}

const struct machine_cost *machine_cost(struct machine *machine, uint32_t number)
{
    return machine->profile && number < machine->profile->cost_count ? &machine->profile->costs[number] : NULL;
}

const char *machine_row_name(int32_t row) { return row >= 0 && row < INSTRUCTION_ROWS ? ROW_NAMES[row] : ""; }
