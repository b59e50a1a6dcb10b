/* Calls of watched functions, while firmware runs.
 *
 * A function is watched at its first instruction and at the return addresses of its calls. A call counts from the
 * function's first instruction to its return, both included. Exceptions are counted separately: from entry to return,
 * both included, with all nested exceptions, and with the extra cycles of the interrupted code because the exception
 * emptied the pipeline. Each active exception, and each task of a kernel, is a thread with calls of its own: an
 * interrupted thread resumes when registers are restored from the address at which its own were saved.
 *
 * A call that ends in a tail call contains it, and returns when it does. It is abandoned if the stack pointer rises
 * above its own (longjmp), if it is called anew with the same stack pointer, or if its thread ends.
 */
#include <stdlib.h>
#include <string.h>

#include "code.h"
#include "decode.h"
#include "stacks.h"

enum {
    MOST_OPEN = 256,        /* open calls of a thread */
    MOST_THREADS = 32,      /* threads with open calls */
    MOST_NESTED = 64,       /* nested exceptions */
    MOST_GIVEN_UP = 16,     /* recent calls of a thread whose stack was discarded */
    MOST_FUNCTIONS = 4096,
    MOST_PLACES = 8192,     /* functions, and their return addresses */
    PLACE_BUCKETS = 16384,
    FIRST_ROOM = 1024,
    MOST_CALLS = 1 << 22,   /* calls that were not read yet */
    LONGEST_OVERLAP = 64,   /* instructions; a division keeps the FPU busy for far fewer */
    LINK = 14,
    NONE = -1,
};
static const uint32_t FIRST_EXC_RETURN = 0xFFFFFFE0u; /* a return address from here on ends an exception */

/* Number of interruptions of a thread, their cycles, and cycles of other threads. */
struct apart {
    int32_t times;
    int64_t interrupts, elsewhere;
};

struct open_call {
    int32_t function;
    uint32_t stack, lowest; /* stack pointer at its first instruction, and its lowest value, without exceptions */
    uint32_t return_address;
    bool outermost;
    int64_t entered;
    struct apart apart;     /* of its thread at the entry */
};

struct given_up {
    int32_t function;       /* NONE: the entry is free */
    uint32_t return_address, stack;
};

/* The jump to the next instruction, if any. */
struct arrival {
    bool has_jumped;
    uint32_t from;
};

struct thread {
    bool is_used, is_suspended;
    uint32_t frame;           /* address of its registers, with flags, while it is suspended */
    int64_t left_at;          /* cycle at which an exception was entered */
    struct arrival arrival;   /* of the instruction that it resumes with */
    struct pipeline pipeline; /* before that instruction */
    uint32_t accessed_at;     /* address of the latest access before that instruction */
    struct apart apart;
    int32_t open_count, next_given_up;
    struct given_up given_up[MOST_GIVEN_UP];
    struct open_call open[MOST_OPEN];
};

struct place {
    bool is_used;
    uint32_t address;
    int32_t function; /* the function that begins at the address, or NONE */
};

struct calls {
    struct machine_function functions[MOST_FUNCTIONS];
    int32_t function_count, place_count;
    int64_t open_count;
    bool is_paused;
    int64_t paused_at, paused_cycles;
    int32_t current;                  /* number of the running thread */
    int32_t nested;
    int32_t interrupted[MOST_NESTED]; /* threads, or NONE, by active exceptions, the innermost last */
    struct thread threads[MOST_THREADS];
    struct place places[PLACE_BUCKETS];
    struct machine_call *done;
    int64_t done_count, done_room;
    machine_entered entered;
    void *context;
};

/* -- functions and places ---------------------------------------------------------------------------------------- */

/* Return the entry of an address, or the free entry for it; most are free. */
static struct place *place_of(struct calls *calls, uint32_t address)
{
    uint32_t bucket = (address >> 1) * 0x9E3779B1u % PLACE_BUCKETS;
    while (calls->places[bucket].is_used && calls->places[bucket].address != address)
        bucket = (bucket + 1) % PLACE_BUCKETS;
    return &calls->places[bucket];
}

/* Let `calls_arrive` be called at an address. NULL if there are too many places. */
static struct place *watch_place(struct machine *machine, uint32_t address)
{
    struct calls *calls = machine->calls;
    struct place *place = place_of(calls, address);
    if (place->is_used)
        return place;
    if (calls->place_count == MOST_PLACES || !code_set_mark(machine, address, MARK_WATCHED, true))
        return NULL;
    calls->place_count++;
    *place = (struct place){true, address, NONE};
    return place;
}

static void begin_thread(struct thread *thread)
{
    thread->is_used = true;
    thread->is_suspended = false;
    thread->open_count = thread->next_given_up = 0;
    thread->arrival = (struct arrival){false, 0};
    thread->apart = (struct apart){0, 0, 0};
    for (int i = 0; i < MOST_GIVEN_UP; i++)
        thread->given_up[i].function = NONE;
}

static bool begin_calls(struct machine *machine)
{
    if (!machine->calls) {
        machine->calls = calloc(1, sizeof *machine->calls);
        if (machine->calls)
            begin_thread(&machine->calls->threads[0]);
    }
    return machine->calls != NULL;
}

int32_t machine_watch(struct machine *machine, uint32_t address)
{
    if (!begin_calls(machine))
        return NONE;
    struct calls *calls = machine->calls;
    struct place *place = calls->function_count < MOST_FUNCTIONS ? watch_place(machine, address) : NULL;
    if (!place)
        return NONE;
    if (place->function == NONE)
        place->function = calls->function_count++;
    return place->function;
}

struct machine_function *machine_watched(struct machine *machine, int32_t function)
{
    struct calls *calls = machine->calls;
    return calls && function >= 0 && function < calls->function_count ? &calls->functions[function] : NULL;
}

void machine_report_entries(struct machine *machine, machine_entered entered, void *context)
{
    if (begin_calls(machine)) {
        machine->calls->entered = entered;
        machine->calls->context = context;
    }
}

void calls_destroy(struct machine *machine)
{
    if (machine->calls)
        free(machine->calls->done);
    free(machine->calls);
    machine->calls = NULL;
}

/* -- time, and completed calls ------------------------------------------------------------------------------------ */

static int64_t now(const struct machine *machine) { return machine->core.cycles - machine->calls->paused_cycles; }

static struct thread *current_thread(const struct machine *machine)
{
    return &machine->calls->threads[machine->calls->current];
}

/* Return a new record of a completed call; NULL if out of memory, or if too many calls were not read. */
static struct machine_call *new_call(struct calls *calls)
{
    if (calls->done_count == calls->done_room) {
        int64_t room = calls->done_room ? 2 * calls->done_room : FIRST_ROOM;
        size_t bytes = (size_t)room * sizeof *calls->done;
        struct machine_call *done = room > MOST_CALLS ? NULL : realloc(calls->done, bytes);
        if (!done)
            return NULL;
        calls->done = done;
        calls->done_room = room;
    }
    return &calls->done[calls->done_count++];
}

static uint32_t word_at(struct machine *machine, const struct machine_function *function)
{
    uint32_t word = 0, size = function->word_size;
    return size <= sizeof word && machine_read(machine, function->word_address, size, (uint8_t *)&word) ? word : 0;
}

/* Record a call that returned at a cycle by the instruction `place`. */
static void close_call(
    struct machine *machine, const struct thread *thread, const struct open_call *open, int64_t cycle, uint32_t place)
{
    struct machine_function *function = &machine->calls->functions[open->function];
    struct machine_call *call = new_call(machine->calls);
    if (!call) {
        function->lost++;
        return;
    }
    *call = (struct machine_call){
        .entered = open->entered,
        .returned = cycle,
        .interrupts = thread->apart.interrupts - open->apart.interrupts,
        .elsewhere = thread->apart.elsewhere - open->apart.elsewhere,
        .interrupted = thread->apart.times - open->apart.times,
        .function = open->function,
        .ended_in = place,
        .word = function->word_size ? word_at(machine, function) : 0,
        .stack = stacks_used(machine, open->stack, open->lowest),
        .outermost = open->outermost,
    };
}

const struct machine_call *machine_calls(struct machine *machine, int64_t *count)
{
    *count = machine->calls ? machine->calls->done_count : 0;
    return machine->calls ? machine->calls->done : NULL;
}

void machine_forget_calls(struct machine *machine)
{
    if (machine->calls)
        machine->calls->done_count = 0;
}

/* -- open calls ---------------------------------------------------------------------------------------------------- */

static void count_open(struct calls *calls, int32_t function, int more)
{
    calls->functions[function].open += more;
    calls->open_count += more;
}

static void lower(uint32_t *lowest, uint32_t address)
{
    if (address < *lowest)
        *lowest = address;
}

/* Record the lowest stack pointer in the innermost call. */
static void take_lowest(const struct machine *machine, struct thread *thread)
{
    if (thread->open_count && machine->history.stacks.lowest)
        lower(&thread->open[thread->open_count - 1].lowest, machine->history.stacks.lowest);
}

/* Pass the lowest stack pointers of calls from a number on to the outer calls. */
static void lower_outer(struct thread *thread, int32_t first)
{
    for (int32_t i = thread->open_count - 1; i > 0 && i >= first; i--)
        lower(&thread->open[i - 1].lowest, thread->open[i].lowest);
}

/* Abandon calls from a number on. */
static void abandon(struct calls *calls, struct thread *thread, int32_t first)
{
    lower_outer(thread, first);
    while (thread->open_count > first) {
        int32_t function = thread->open[--thread->open_count].function;
        calls->functions[function].abandoned++;
        count_open(calls, function, -1);
    }
}

static struct given_up *given_up_at(struct thread *thread, uint32_t return_address, uint32_t stack)
{
    for (int i = 0; i < MOST_GIVEN_UP; i++) {
        struct given_up *call = &thread->given_up[i];
        if (call->function != NONE && call->return_address == return_address && call->stack == stack)
            return call;
    }
    return NULL;
}

/* Abandon and record the calls whose stack was discarded: the stack pointer is above theirs. */
static void give_up_below(struct calls *calls, struct thread *thread, uint32_t stack)
{
    while (thread->open_count && thread->open[thread->open_count - 1].stack < stack) {
        const struct open_call *call = &thread->open[thread->open_count - 1];
        struct given_up *entry = given_up_at(thread, call->return_address, call->stack);
        if (!entry) {
            entry = &thread->given_up[thread->next_given_up];
            thread->next_given_up = (thread->next_given_up + 1) % MOST_GIVEN_UP;
        }
        *entry = (struct given_up){call->function, call->return_address, call->stack};
        abandon(calls, thread, thread->open_count - 1);
    }
}

/* Return the first call that began with a stack pointer, if no call is below it. */
static int32_t first_with(const struct thread *thread, uint32_t stack)
{
    int32_t first = thread->open_count;
    while (first && thread->open[first - 1].stack == stack)
        first--;
    return first;
}

static struct instruction instruction_at(struct machine *machine, uint32_t address)
{
    uint16_t first = 0, second = 0;
    struct instruction instruction;
    if (fetch(machine, address, &first) && instruction_size(first) == 4)
        fetch(machine, address + 2, &second);
    decode_instruction(address, first, second, 0, machine->baseline, &instruction);
    return instruction;
}

static struct arrival arrival_of(const struct machine *machine)
{
    bool has_jumped = machine->history.jumped_at == machine->core.instructions;
    return (struct arrival){has_jumped, machine->history.jumped_from};
}

static bool writes_link(const struct instruction *instruction) { return instruction->core_writes >> LINK & 1; }

static bool is_by_call(struct machine *machine, const struct arrival *arrival)
{
    const struct instruction jump = instruction_at(machine, arrival->from);
    return arrival->has_jumped && writes_link(&jump);
}

static bool may_be_by_return(struct machine *machine, const struct arrival *arrival)
{
    const struct instruction jump = instruction_at(machine, arrival->from);
    return arrival->has_jumped && jump.transfer == TRANSFER_INDIRECT && jump.row != ROW_table_branch
        && !writes_link(&jump);
}

/* Close the calls that return to the next instruction. */
static void return_calls(struct machine *machine, uint32_t address, const struct arrival *arrival)
{
    struct calls *calls = machine->calls;
    struct thread *thread = current_thread(machine);
    const uint32_t stack = machine->core.r[13];
    if (thread->open_count)
        give_up_below(calls, thread, stack);
    int32_t first = first_with(thread, stack);
    while (first < thread->open_count && thread->open[first].return_address != address)
        first++;
    struct given_up *given_up = first == thread->open_count ? given_up_at(thread, address, stack) : NULL;
    if (first == thread->open_count && !given_up)
        return;
    bool returns = may_be_by_return(machine, arrival);
    if (given_up && returns) {
        calls->functions[given_up->function].came_back++;
        given_up->function = NONE;
    }
    lower_outer(thread, first);
    for (int32_t i = first; i < thread->open_count; i++) {
        const struct open_call *call = &thread->open[i];
        if (returns && call->return_address == address)
            close_call(machine, thread, call, now(machine), arrival->from);
        else /* the return address was reached by a jump that is not a return */
            calls->functions[call->function].abandoned++;
        count_open(calls, call->function, -1);
    }
    thread->open_count = first;
}

static bool is_outermost(const struct calls *calls, const struct thread *thread, int32_t function)
{
    if (!calls->functions[function].open)
        return true;
    for (int32_t i = 0; i < thread->open_count; i++)
        if (thread->open[i].function == function)
            return false;
    return true;
}

/* Return the cycles of a function's first instruction that belong to the caller, because of its branch. */
static int64_t late_cycles(const struct machine *machine, const struct node *node)
{
    struct pipeline after, state = *code_state(machine, node->state);
    if (state.reached == REACHED_ANYHOW)
        return 0;
    int32_t cycles = price_instruction(&machine->prices, &node->instruction, node->address, &state, &after);
    state.reached = REACHED_ANYHOW;
    return cycles - price_instruction(&machine->prices, &node->instruction, node->address, &state, &after);
}

/* Return whether the call that begins is an open one: it jumps to its own beginning, or its first instruction is
 * repeated. A call from the address of another one with the same stack pointer ends that one. */
static bool goes_on(
    struct machine *machine, int32_t function, uint32_t return_address, const struct arrival *arrival, int64_t cycle)
{
    struct thread *thread = current_thread(machine);
    int32_t first = first_with(thread, machine->core.r[13]);
    bool is_called = first < thread->open_count && is_by_call(machine, arrival);
    for (int32_t i = first; i < thread->open_count; i++) {
        const struct open_call *call = &thread->open[i];
        if (call->function == function && (call->entered == cycle || !is_called))
            return true;
        if (is_called && (call->function == function || call->return_address == return_address)) {
            abandon(machine->calls, thread, i);
            return false;
        }
    }
    return false;
}

static void enter_function(
    struct machine *machine, const struct node *node, int32_t function, const struct arrival *arrival)
{
    struct calls *calls = machine->calls;
    struct thread *thread = current_thread(machine);
    const uint32_t stack = machine->core.r[13], return_address = machine->core.r[LINK] & ~1u;
    const int64_t cycle = now(machine) + late_cycles(machine, node);
    if (goes_on(machine, function, return_address, arrival, cycle))
        return;
    struct given_up *given_up = given_up_at(thread, return_address, stack);
    if (given_up)
        given_up->function = NONE;
    bool is_exception = return_address >= FIRST_EXC_RETURN;
    if (thread->open_count == MOST_OPEN || (!is_exception && !watch_place(machine, return_address))) {
        calls->functions[function].lost++;
        return;
    }
    thread->open[thread->open_count] = (struct open_call){
        function, stack, stack, return_address, is_outermost(calls, thread, function), cycle, thread->apart,
    };
    thread->open_count++;
    count_open(calls, function, 1);
    if (calls->functions[function].reports_entries && calls->entered) {
        calls->entered(calls->context, function, cycle);
        forget_answers(machine); /* the listener may have changed devices */
    }
}

void calls_arrive(struct machine *machine, const struct node *node)
{
    struct calls *calls = machine->calls;
    if (!calls || calls->is_paused)
        return;
    const struct arrival arrival = arrival_of(machine);
    take_lowest(machine, current_thread(machine));
    return_calls(machine, node->address, &arrival);
    int32_t function = place_of(calls, node->address)->function;
    if (place_of(calls, node->address)->is_used && function != NONE)
        enter_function(machine, node, function, &arrival);
    stacks_record_lowest(machine, calls->open_count > 0);
}

/* -- threads ------------------------------------------------------------------------------------------------------ */

/* Record the state that a thread needs to resume. */
static void leave_thread(struct machine *machine, struct thread *thread)
{
    take_lowest(machine, thread);
    thread->left_at = now(machine);
    thread->arrival = arrival_of(machine);
    thread->pipeline = machine->history.pipeline;
    thread->accessed_at = machine->history.accessed_at;
}

/* Return the address of a load or store of one word. */
static uint32_t accessed_address(const struct core *core, const struct instruction *instruction)
{
    switch ((instruction->operation - OP_LDR_I) % ACCESS_FORM_COUNT) {
    case ACCESS_REGISTER: return core->r[instruction->n] + (core->r[instruction->m] << instruction->amount);
    case ACCESS_LITERAL: return instruction->immediate;
    case ACCESS_WRITES_BACK:
        return core->r[instruction->n] + (instruction->mode & MODE_POST ? 0 : instruction->immediate);
    default: return core->r[instruction->n] + instruction->immediate;
    }
}

/* Return the cycles that the instruction at the PC waits because it overlaps a load in another memory block, unless the
 * pipeline is empty. */
static int64_t other_block_cycles(struct machine *machine, const struct thread *thread)
{
    const struct instruction instruction = instruction_at(machine, machine->core.r[15]);
    if (!overlaps_load(&machine->prices, &instruction, &thread->pipeline)
        || is_same_block(machine, thread->accessed_at, accessed_address(&machine->core, &instruction)))
        return 0;
    return machine->prices.value[ROW_load_other_block];
}

/* Return the extra cycles of the code at the PC that are due to an emptied pipeline. */
static int64_t emptied_pipeline_cycles(struct machine *machine, const struct thread *thread)
{
    struct pipeline emptied, state = thread->pipeline;
    uint32_t address = machine->core.r[15];
    int64_t cycles = -other_block_cycles(machine, thread);
    memset(&emptied, 0, sizeof emptied);
    for (int i = 0; i < LONGEST_OVERLAP && memcmp(&state, &emptied, sizeof state) != 0; i++) {
        const struct instruction instruction = instruction_at(machine, address);
        cycles += price_instruction(&machine->prices, &instruction, address, &emptied, &emptied);
        cycles -= price_instruction(&machine->prices, &instruction, address, &state, &state);
        address += instruction.size;
    }
    return cycles;
}

/* Resume a thread. */
static void resume_thread(struct machine *machine, struct thread *thread)
{
    thread->is_suspended = false;
    machine->history.jumped_from = thread->arrival.from;
    machine->history.jumped_at = thread->arrival.has_jumped ? machine->core.instructions : -1;
    stacks_record_lowest(machine, machine->calls->open_count > 0);
}

static void end_thread(struct calls *calls, struct thread *thread)
{
    abandon(calls, thread, 0);
    thread->is_used = false;
}

static struct thread *suspended_at(struct calls *calls, uint32_t frame)
{
    for (int i = 0; i < MOST_THREADS; i++) {
        struct thread *thread = &calls->threads[i];
        if (thread->is_used && thread->is_suspended && thread->frame == frame)
            return thread;
    }
    return NULL;
}

static int32_t new_thread(struct calls *calls)
{
    for (int32_t i = 0; i < MOST_THREADS; i++)
        if (!calls->threads[i].is_used) {
            begin_thread(&calls->threads[i]);
            return i;
        }
    return NONE;
}

void calls_reset(struct machine *machine)
{
    struct calls *calls = machine->calls;
    if (!calls)
        return;
    for (int i = 0; i < MOST_THREADS; i++)
        end_thread(calls, &calls->threads[i]);
    begin_thread(&calls->threads[0]);
    calls->current = calls->nested = 0;
    stacks_record_lowest(machine, false);
}

static void push(struct calls *calls, int32_t thread)
{
    if (calls->nested < MOST_NESTED)
        calls->interrupted[calls->nested++] = thread;
}

/* End threads when an exception was entered from thread mode: earlier active exceptions are over, and a thread that was
 * suspended at this frame has lost its stack. */
static void end_stale_threads(struct calls *calls, uint32_t frame)
{
    while (calls->nested) {
        int32_t number = calls->interrupted[--calls->nested];
        if (number != NONE && number != calls->current && !calls->threads[number].is_suspended)
            end_thread(calls, &calls->threads[number]);
    }
    struct thread *stale = suspended_at(calls, frame);
    if (stale)
        end_thread(calls, stale);
}

void calls_entered(struct machine *machine, uint32_t frame)
{
    struct calls *calls = machine->calls;
    if (!calls || calls->is_paused)
        return;
    bool from_thread = (frame & FRAME_OF_THREAD) != 0;
    if (from_thread)
        end_stale_threads(calls, frame);
    struct thread *thread = current_thread(machine);
    if (!thread->open_count) { /* a thread without calls needs no record: the handler reuses its number */
        push(calls, NONE);
        return;
    }
    int32_t handler = new_thread(calls);
    if (handler == NONE) {
        for (int32_t i = 0; i < thread->open_count; i++)
            calls->functions[thread->open[i].function].lost++;
        abandon(calls, thread, 0);
        push(calls, NONE);
        return;
    }
    leave_thread(machine, thread);
    thread->is_suspended = from_thread;
    thread->frame = frame;
    push(calls, calls->current);
    calls->current = handler;
}

/* Close the calls of an exception's handler, and of functions that the handler tail-called. */
static void end_handler(struct machine *machine, struct thread *handler, uint32_t place)
{
    take_lowest(machine, handler);
    while (handler->open_count && handler->open[handler->open_count - 1].return_address >= FIRST_EXC_RETURN) {
        lower_outer(handler, handler->open_count - 1);
        const struct open_call *call = &handler->open[--handler->open_count];
        count_open(machine->calls, call->function, -1);
        close_call(machine, handler, call, now(machine), place);
    }
    abandon(machine->calls, handler, 0);
}

void calls_left(struct machine *machine, uint32_t frame, int32_t cycles, uint32_t place)
{
    struct calls *calls = machine->calls;
    if (!calls || calls->is_paused)
        return;
    struct thread *handler = current_thread(machine);
    if (handler->open_count)
        end_handler(machine, handler, place);
    int32_t number = calls->nested ? calls->interrupted[--calls->nested] : NONE;
    struct thread *interrupted = number == NONE ? NULL : &calls->threads[number];
    struct thread *thread = frame & FRAME_OF_THREAD ? suspended_at(calls, frame) : interrupted;
    if (!thread) /* it has no calls, or is new */
        return;
    int64_t gone = now(machine) + cycles - thread->left_at + emptied_pipeline_cycles(machine, thread);
    if (thread == interrupted) {
        thread->apart.times++;
        thread->apart.interrupts += gone;
    } else {
        thread->apart.elsewhere += gone;
    }
    handler->is_used = false;
    calls->current = (int32_t)(thread - calls->threads);
    resume_thread(machine, thread);
}

/* -- pauses ------------------------------------------------------------------------------------------------------- */

void machine_pause_calls(struct machine *machine)
{
    struct calls *calls = machine->calls;
    if (!calls || calls->is_paused)
        return;
    leave_thread(machine, current_thread(machine));
    calls->paused_at = machine->core.cycles;
    calls->is_paused = true;
}

void machine_resume_calls(struct machine *machine)
{
    struct calls *calls = machine->calls;
    if (!calls || !calls->is_paused)
        return;
    struct thread *thread = current_thread(machine);
    calls->is_paused = false;
    calls->paused_cycles += machine->core.cycles - calls->paused_at;
    calls->paused_cycles += emptied_pipeline_cycles(machine, thread);
    resume_thread(machine, thread);
}

int64_t machine_unpaused_cycles(struct machine *machine)
{
    return machine->calls ? now(machine) : machine->core.cycles;
}
