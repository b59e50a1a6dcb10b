/*
 * Sees calls of functions while firmware runs: `RunningCalls` of running_calls.py, in C, with the same rules and
 * names. Python reads what is done, hooks where calls return to, and prices what an emptied pipeline costs.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
    MOST_OPEN = 256,    /* calls under way in a thread; beyond, the function is refused by name */
    MOST_THREADS = 32,  /* with calls under way */
    MOST_NESTED = 64,   /* exceptions */
    MOST_GIVEN_UP = 16, /* calls of a thread whose stack was given up; the latest */
    MOST_DONE = 4096,
    PLACES = 16384, /* of the table of addresses: a power of two */
    NONE = -1,
};

enum { OF_THREAD = 2 }; /* flag of a frame: an exception entered from thread mode, or returns to it */

/* What the last instruction of a block may have done; and that behind it nothing in the pipeline is left to overlap. */
enum { CALLS = 1 << 0, RETURNS = 1 << 1, LEAVES_NOTHING = 1 << 2 };

static const uint32_t UNKNOWN = UINT32_MAX; /* no address, nor a size */
static const uint32_t EXC_RETURN = 0xFFFFFFE0u; /* a return address from here on ends an exception */

struct apart {
    int64_t times;
    int64_t interrupts;
    int64_t elsewhere;
};

struct last { /* what a thread executed last */
    uint32_t place;
    uint32_t kind;
};

struct function {
    int64_t abandoned;
    int64_t open;
    int64_t came_back;
    int64_t lost;       /* calls for which there was no room */
    uint64_t looks_at;  /* address of the word that is read at a return */
    uint64_t look_size; /* 0: none is */
};

struct open_call {
    int32_t function;
    uint32_t stack;
    uint32_t lowest; /* that the stack pointer has been in it, without exceptions */
    uint32_t return_address;
    uint32_t outermost;
    int64_t entered;
    struct apart apart;
};

struct given_up {
    uint32_t return_address;
    uint32_t stack;
    int32_t function; /* NONE: free */
};

struct thread {
    bool used;
    bool suspended;
    uint32_t frame; /* where its registers are, with flags */
    int64_t left_at;
    int64_t resumed_behind;
    struct apart apart;
    struct last before;
    uint32_t state; /* entry of the block that would have followed, see block_hook.c */
    uint32_t open_calls;
    uint32_t next_given_up;
    struct given_up given_up[MOST_GIVEN_UP];
    struct open_call open[MOST_OPEN];
};

struct done {
    int64_t entered;
    int64_t returned;
    struct apart apart;
    int32_t function;
    uint32_t outermost;
    uint32_t place;
    uint32_t left;
    uint32_t stack; /* bytes of it, or UNKNOWN */
};

struct place { /* an address that is hooked, or is about to be */
    uint32_t address;
    int32_t function; /* that begins there, or NONE */
    uint32_t used;
};

struct calls {
    /* Set by Python. */
    void *engine;
    void *counter;
    const int64_t *cycles;
    const int64_t *instructions;
    const int64_t *before_number; /* of the block that ended last */
    const uint32_t *const *running; /* the block that runs: address, how long its beginning waits, how it lowers the stack */
    const struct last *const *ends; /* of each block, by number */
    const uint32_t *state;
    const uint32_t (*stacks)[2]; /* the two that the stack pointer was on last: how low it has been, and the top */
    uint32_t *lowest;            /* that it has been: before the block that was looked at, and in it */
    struct function *functions;
    int (*read_register)(void *engine, int number, void *value);
    int (*read_memory)(void *engine, uint64_t address, void *bytes, size_t size);
    int64_t (*before)(uint32_t address); /* cycles of the block that runs before one of its instructions */
    int64_t (*emptied)(uint32_t state);  /* how much longer the code at the PC takes, not behind that */
    void (*returns_to)(uint32_t address);
    void (*full)(void);
    int32_t stack_register;
    int32_t link_register;
    /* Read by Python. */
    int64_t open_calls;
    int64_t paused_cycles;
    int64_t done_count;
    int32_t is_paused;
    int32_t nested;
    int32_t current;
    int32_t interrupted[MOST_NESTED];
    struct done done[MOST_DONE];
    struct place places[PLACES];
    struct thread threads[MOST_THREADS];
};

void hiltest_end_watch(void *counter);

size_t hiltest_calls_size(void)
{
    return sizeof(struct calls);
}

static struct place *place_of(struct calls *calls, uint32_t address)
{
    uint32_t at = (address >> 1) * 0x9E3779B1u % PLACES;

    while (calls->places[at].used != 0 && calls->places[at].address != address) {
        at = (at + 1) % PLACES;
    }
    return &calls->places[at];
}

/* Note an address; `function` is what begins there, or NONE. Python keeps the table at most half full. */
void hiltest_calls_note(struct calls *calls, uint32_t address, int32_t function)
{
    struct place *place = place_of(calls, address);

    if (place->used == 0) {
        place->used = 1;
        place->address = address;
        place->function = NONE;
    }
    if (function != NONE) {
        place->function = function;
    }
}

static void clear_thread(struct thread *thread)
{
    thread->used = true;
    thread->suspended = false;
    thread->open_calls = 0;
    thread->resumed_behind = -1;
    thread->state = 0;
    thread->next_given_up = 0;
    memset(&thread->apart, 0, sizeof thread->apart);
    for (int at = 0; at < MOST_GIVEN_UP; at++) {
        thread->given_up[at].function = NONE;
    }
}

static void count(struct calls *calls, int32_t function, int more)
{
    calls->functions[function].open += more;
    calls->open_calls += more;
}

static void lower(uint32_t *lowest, uint32_t other)
{
    if (other < *lowest) {
        *lowest = other;
    }
}

/* Give what the stack pointer has been to the innermost call; what the block that runs does with it belongs to what
 * comes, where it has not ended. */
static void take_lowest(struct calls *calls, struct thread *thread, bool has_ended)
{
    if (has_ended) {
        lower(&calls->lowest[0], calls->lowest[1]);
        calls->lowest[1] = UNKNOWN;
    }
    if (thread->open_calls > 0) {
        lower(&thread->open[thread->open_calls - 1].lowest, calls->lowest[0]);
    }
    calls->lowest[0] = UNKNOWN;
}

static void abandon(struct calls *calls, struct thread *thread, uint32_t first)
{
    for (uint32_t at = thread->open_calls; at-- > first;) {
        if (at > 0) {
            lower(&thread->open[at - 1].lowest, thread->open[at].lowest);
        }
        calls->functions[thread->open[at].function].abandoned++;
        count(calls, thread->open[at].function, -1);
    }
    thread->open_calls = first < thread->open_calls ? first : thread->open_calls;
}

/* Begin anew: the processor was reset, or nothing was seen yet. */
void hiltest_calls_reset(struct calls *calls)
{
    for (int at = 0; at < MOST_THREADS; at++) {
        abandon(calls, &calls->threads[at], 0);
        calls->threads[at].used = false;
    }
    calls->lowest[0] = calls->lowest[1] = UNKNOWN;
    calls->nested = 0;
    calls->current = 0;
    clear_thread(&calls->threads[0]);
}

static struct thread *new_thread(struct calls *calls)
{
    for (int at = 0; at < MOST_THREADS; at++) {
        if (!calls->threads[at].used) {
            clear_thread(&calls->threads[at]);
            return &calls->threads[at];
        }
    }
    return NULL;
}

static struct last last_of(const struct calls *calls, const struct thread *thread)
{
    struct last unknown = {0, CALLS | RETURNS}; /* of code that was rewritten */

    if (*calls->instructions == thread->resumed_behind) {
        return thread->before;
    }
    return *calls->before_number < 0 ? unknown : (*calls->ends)[*calls->before_number];
}

static int64_t now_of(const struct calls *calls)
{
    return *calls->cycles - calls->paused_cycles;
}

/* Return the bytes of stack that a call has taken; UNKNOWN where it has been on two stacks. */
static uint32_t stack_of(const struct calls *calls, const struct open_call *call)
{
    for (int at = 0; at < 2; at++) {
        if (calls->stacks[at][0] <= call->lowest && call->stack <= calls->stacks[at][1]) {
            return call->stack - call->lowest;
        }
    }
    return UNKNOWN;
}

static void close_call(
    struct calls *calls, const struct thread *thread, const struct open_call *call, int64_t now,
    uint32_t place)
{
    const struct function *function = &calls->functions[call->function];
    struct done *done;

    if (calls->done_count == MOST_DONE) {
        calls->full();
    }
    done = &calls->done[calls->done_count++];
    done->entered = call->entered;
    done->returned = now;
    done->apart.times = thread->apart.times - call->apart.times;
    done->apart.interrupts = thread->apart.interrupts - call->apart.interrupts;
    done->apart.elsewhere = thread->apart.elsewhere - call->apart.elsewhere;
    done->function = call->function;
    done->outermost = call->outermost;
    done->place = place;
    done->left = 0;
    done->stack = stack_of(calls, call);
    if (function->look_size != 0) {
        (void)calls->read_memory(calls->engine, function->looks_at, &done->left, function->look_size);
    }
}

static struct given_up *given_up_at(struct thread *thread, uint32_t return_address, uint32_t stack)
{
    for (int at = 0; at < MOST_GIVEN_UP; at++) {
        struct given_up *each = &thread->given_up[at];

        if (each->function != NONE && each->return_address == return_address && each->stack == stack) {
            return each;
        }
    }
    return NULL;
}

static uint32_t first_with(const struct thread *thread, uint32_t stack)
{
    uint32_t first = thread->open_calls;

    while (first > 0 && thread->open[first - 1].stack == stack) {
        first--;
    }
    return first;
}

static void give_up_below(struct calls *calls, struct thread *thread, uint32_t stack)
{
    while (thread->open_calls > 0 && thread->open[thread->open_calls - 1].stack < stack) {
        const struct open_call *call = &thread->open[thread->open_calls - 1];
        struct given_up *known = given_up_at(thread, call->return_address, call->stack);

        if (known == NULL) {
            known = &thread->given_up[thread->next_given_up++ % MOST_GIVEN_UP];
        }
        known->return_address = call->return_address;
        known->stack = call->stack;
        known->function = call->function;
        abandon(calls, thread, thread->open_calls - 1);
    }
}

static void arrives(struct calls *calls, uint32_t address, uint32_t stack, int64_t now, struct last last)
{
    struct thread *thread = &calls->threads[calls->current];
    bool returns = (last.kind & RETURNS) != 0;
    uint32_t first;

    give_up_below(calls, thread, stack);
    first = first_with(thread, stack);
    while (first < thread->open_calls && thread->open[first].return_address != address) {
        first++;
    }
    if (first == thread->open_calls) {
        struct given_up *known = returns ? given_up_at(thread, address, stack) : NULL;

        if (known != NULL) {
            calls->functions[known->function].came_back++;
            known->function = NONE;
        }
        return;
    }
    for (uint32_t at = thread->open_calls - 1; at > 0 && at >= first; at--) {
        lower(&thread->open[at - 1].lowest, thread->open[at].lowest);
    }
    for (uint32_t at = first; at < thread->open_calls; at++) {
        const struct open_call *call = &thread->open[at];

        if (returns && call->return_address == address) {
            close_call(calls, thread, call, now, last.place);
        } else { /* where the call would have returned to was jumped to */
            calls->functions[call->function].abandoned++;
        }
        count(calls, call->function, -1);
    }
    thread->open_calls = first;
}

static bool is_outermost(const struct calls *calls, const struct thread *thread, int32_t function)
{
    if (calls->functions[function].open == 0) {
        return true;
    }
    for (uint32_t at = 0; at < thread->open_calls; at++) {
        if (thread->open[at].function == function) {
            return false;
        }
    }
    return true;
}

static void enters(
    struct calls *calls, int32_t function, uint32_t stack, uint32_t return_address, int64_t now, struct last last)
{
    struct thread *thread = &calls->threads[calls->current];
    bool called = (last.kind & CALLS) != 0;
    struct given_up *known;
    struct open_call *call;

    for (uint32_t at = first_with(thread, stack); at < thread->open_calls; at++) {
        const struct open_call *each = &thread->open[at];

        if (each->function == function && (each->entered == now || !called)) {
            return; /* the emulator was stopped there and comes to it again, or it jumps to its own beginning */
        }
        if (called && (each->function == function || each->return_address == return_address)) {
            abandon(calls, thread, at);
            break;
        }
    }
    known = given_up_at(thread, return_address, stack);
    if (known != NULL) {
        known->function = NONE;
    }
    if (thread->open_calls == MOST_OPEN) {
        calls->functions[function].lost++;
        return;
    }
    call = &thread->open[thread->open_calls];
    call->function = function;
    call->stack = stack;
    call->lowest = stack;
    call->return_address = return_address;
    call->outermost = is_outermost(calls, thread, function);
    call->entered = now;
    call->apart = thread->apart;
    thread->open_calls++;
    count(calls, function, 1);
    if (return_address < EXC_RETURN && place_of(calls, return_address)->used == 0) {
        hiltest_calls_note(calls, return_address, NONE);
        calls->returns_to(return_address);
    }
}

/* The emulator is about to execute an instruction that is hooked: its code hook. */
void hiltest_calls_on_code(void *engine, uint64_t address64, uint32_t size, void *data)
{
    struct calls *calls = data;
    uint32_t address = (uint32_t)address64;
    uint32_t stack = 0;
    uint32_t link = 0;
    struct last last = {0, 0};
    bool begins_block = *calls->running != NULL && **calls->running == address;
    int64_t late = 0;
    int64_t now;
    int32_t function;

    (void)size;
    if (calls->is_paused != 0) {
        return;
    }
    hiltest_end_watch(calls->counter); /* each call is seen */
    now = now_of(calls);
    if (begins_block) {
        last = last_of(calls, &calls->threads[calls->current]);
        late = (*calls->running)[1];
    } else {
        now += calls->before(address);
    }
    (void)calls->read_register(engine, calls->stack_register, &stack);
    take_lowest(calls, &calls->threads[calls->current], !begins_block || (*calls->running)[2] == 0);
    arrives(calls, address, stack, now, last);
    function = place_of(calls, address)->function;
    if (function != NONE) {
        (void)calls->read_register(engine, calls->link_register, &link);
        enters(calls, function, stack, link & ~1u, now + late, last);
    }
}

/* Keep what the thread needs to go on; returns the entry that the next block would have had, or 0. */
uint32_t hiltest_calls_leave(struct calls *calls)
{
    struct thread *thread = &calls->threads[calls->current];

    take_lowest(calls, thread, true);
    thread->left_at = now_of(calls);
    thread->state = 0;
    if (*calls->instructions != thread->resumed_behind) { /* else it was left before it ran, and loses nothing more */
        thread->before = last_of(calls, thread);
        thread->state = (thread->before.kind & LEAVES_NOTHING) != 0 ? 0 : *calls->state;
    }
    return thread->state;
}

/* It goes on, after cycles that were not the firmware's. */
void hiltest_calls_resume(struct calls *calls, int64_t cycles)
{
    calls->paused_cycles += cycles;
    calls->lowest[0] = calls->lowest[1] = UNKNOWN;
    calls->threads[calls->current].resumed_behind = *calls->instructions;
}

static struct thread *suspended_at(struct calls *calls, uint32_t frame)
{
    for (int at = 0; at < MOST_THREADS; at++) {
        if (calls->threads[at].used && calls->threads[at].suspended && calls->threads[at].frame == frame) {
            return &calls->threads[at];
        }
    }
    return NULL;
}

static void push(struct calls *calls, int32_t thread)
{
    if (calls->nested < MOST_NESTED) {
        calls->interrupted[calls->nested++] = thread;
    }
}

/* An exception was entered, before the cycles of that are counted. */
int hiltest_calls_entered(struct calls *calls, uint32_t frame)
{
    bool from_thread = (frame & OF_THREAD) != 0;
    struct thread *thread = &calls->threads[calls->current];
    struct thread *handler;

    if (calls->is_paused != 0) {
        return 0;
    }
    if (from_thread) {
        struct thread *old = suspended_at(calls, frame);

        while (calls->nested > 0) { /* none of them goes on */
            int32_t at = calls->interrupted[--calls->nested];

            if (at != NONE && at != calls->current && !calls->threads[at].suspended) {
                abandon(calls, &calls->threads[at], 0);
                calls->threads[at].used = false;
            }
        }
        if (old != NULL) { /* its stack is another's now */
            abandon(calls, old, 0);
            old->used = false;
        }
    }
    if (thread->open_calls == 0) { /* there is nothing to keep: the handler takes it over */
        push(calls, NONE);
        return 0;
    }
    handler = new_thread(calls);
    if (handler == NULL) { /* no room: these calls are lost, and said to be */
        for (uint32_t at = 0; at < thread->open_calls; at++) {
            calls->functions[thread->open[at].function].lost++;
        }
        abandon(calls, thread, 0);
        push(calls, NONE);
        return 0;
    }
    (void)hiltest_calls_leave(calls);
    thread->suspended = from_thread;
    thread->frame = frame;
    push(calls, calls->current);
    calls->current = (int32_t)(handler - calls->threads);
    return 0;
}

static void end_handler(struct calls *calls, struct thread *handler)
{
    struct last last = last_of(calls, handler);

    take_lowest(calls, handler, true);
    while (handler->open_calls > 0 && handler->open[handler->open_calls - 1].return_address >= EXC_RETURN) {
        const struct open_call *call = &handler->open[--handler->open_calls];

        if (handler->open_calls > 0) {
            lower(&handler->open[handler->open_calls - 1].lowest, call->lowest);
        }
        count(calls, call->function, -1);
        close_call(calls, handler, call, now_of(calls), last.place);
    }
    abandon(calls, handler, 0);
}

static struct thread *goes_on(struct calls *calls, uint32_t frame, int32_t interrupted)
{
    if ((frame & OF_THREAD) != 0) {
        return suspended_at(calls, frame);
    }
    return interrupted == NONE ? NULL : &calls->threads[interrupted];
}

/* An exception was left, before the cycles of that are counted. */
int hiltest_calls_left(struct calls *calls, uint32_t frame, int32_t cycles)
{
    struct thread *handler = &calls->threads[calls->current];
    struct thread *thread;
    int32_t interrupted;
    int64_t gone;

    if (calls->is_paused != 0) {
        return 0;
    }
    interrupted = calls->nested > 0 ? calls->interrupted[--calls->nested] : NONE;
    if (handler->open_calls > 0) {
        end_handler(calls, handler);
    }
    thread = goes_on(calls, frame, interrupted);
    if (thread == NULL) { /* one without calls, or that begins */
        return 0;
    }
    gone = now_of(calls) + cycles - thread->left_at;
    if (thread->state != 0) {
        gone += calls->emptied(thread->state);
    }
    if (interrupted != NONE && thread == &calls->threads[interrupted]) {
        thread->apart.times++;
        thread->apart.interrupts += gone;
    } else {
        thread->apart.elsewhere += gone;
    }
    calls->lowest[0] = calls->lowest[1] = UNKNOWN; /* the handler's */
    thread->resumed_behind = *calls->instructions;
    thread->suspended = false;
    handler->used = false;
    calls->current = (int32_t)(thread - calls->threads);
    return 0;
}
