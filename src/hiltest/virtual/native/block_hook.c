/*
 * Counts clock cycles where the emulator begins a block: `BlockAccounting.begins` of accounting.py, in C.
 *
 * Python prices blocks and puts them into a table that it owns; this finds them again. Python is asked when a
 * block is not in the table, and when the processor must look at one before it runs. The emulator's functions
 * come as pointers, so this is linked with nothing but the C library, and it uses nothing of Python.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
    NEUTRAL = 0, /* entry of a block that no pipeline state is left to */
    CORE_REGISTERS = 15,
    STACK_POINTER = 13,
    STATE_REGISTERS = CORE_REGISTERS + 1, /* XPSR has the flags */
    PAGE_BITS = 12,
    PAGE_BYTES = 1 << PAGE_BITS,
};

enum { WRITE_NOT_PERMITTED = 22 }; /* the emulator's UC_MEM_WRITE_PROT */

static const uint32_t IT_STATE = 0x0600FC00u; /* in XPSR */

/* Why the processor must look at a block before it runs. */
enum {
    USES_FPU = 1 << 0,
    ALIGNMENT_INSIDE = 1 << 1,
    CHANGES_MASKS = 1 << 2, /* or sends an event */
    LOOPS_TO_ITSELF = 1 << 3,
    WATCHED = 1 << 4, /* every block, while a loop is watched */
    MAY_WAIT = 1 << 5, /* not a reason: it changes nothing but core registers and flags */
    MAY_BE_PROVED = 1 << 6, /* nor this: Python may know what it changes */
    WATCHED_INSIDE = 1 << 7, /* instructions of IT blocks: whether they are executed */
};

/* Nor these: why the stack pointer is looked at when a block begins. */
enum {
    LOWERS_STACK = 1 << 8,
    MOVES_STACK_BY = 1 << 9, /* an amount that is not known before */
    MOVES_STACK = 1 << 10,   /* elsewhere */
    STACK_MOVED = 1 << 11,   /* every block, behind one that moves it */
    STACK_REASONS = LOWERS_STACK | MOVES_STACK_BY | MOVES_STACK | STACK_MOVED,
};

static const uint32_t EXECUTING = 1u << 31; /* in an entry: a block in which an instruction is executed; see there */

/* How a loop is watched. */
enum {
    NO_HEAD = -1,
    MOST_BLOCKS = 96, /* of a turn */
    MOST_READS = 24,  /* of peripherals' registers, in a turn */
    MOST_TURNS = 3,   /* compared with the first; the state of the second replaces that of the first, as it settles */
    LONGEST_WAIT = 1 << 16,    /* turns between two watches: one costs the host some microseconds, */
    LONGEST_WAIT_READING = 32, /* as one read of a register does */
    PROVED_FROM = 8192,        /* with so long a wait Python is asked: a proof takes a tenth of a millisecond or more */
    PROVED_FROM_READING = 8,
    FEWEST_CYCLES_PROVED = 65536, /* before the next event, or as the host is concerned: */
    FEWEST_READS_PROVED = 100,
    LONGEST_REST = 1023,       /* watches between two proofs that were not worth it */
    LONGEST_REST_READING = 31, /* the same where it could be followed */
};

/* What a peripheral declares of a byte of its registers. */
enum {
    STEADY = 1 << 0,  /* reading changes nothing, and only events of the schedule change what is read */
    COUNTED = 1 << 1, /* it wants to know of reads that were passed over */
    COUNTS = 1 << 2,  /* reading changes nothing, and what is read counts with time */
};

/*
 * A block priced from one pipeline state; free places of the table have size 0. An entry is NEUTRAL, another way in which
 * transfers lead to a block, or above those the number of the block that execution fell out of: its pipeline state is
 * the entry's. Of the instructions that are watched in an IT block each block has a version for those that are executed:
 * its entry is EXECUTING and the number of the version without the latest of them, and `executed` is the address of that.
 */
struct block {
    uint32_t address; /* the first three are read by running_calls.c */
    uint32_t late;    /* cycles that its first instruction waits because of how execution comes to it */
    uint32_t lowers;  /* the stack pointer by so many bytes, at most */
    uint32_t size;
    uint32_t entry;   /* that it was priced from */
    uint32_t leaves;  /* entry of what follows its end */
    uint32_t jumps;   /* entry of what it jumps to */
    uint32_t count;   /* instructions */
    uint32_t through; /* cycles, when execution falls out of its end */
    uint32_t taken;   /* cycles, when it jumps away */
    uint32_t reasons; /* to look at it */
    uint32_t aligned; /* registers that must be multiples of four when it begins, bit n for r(n) */
    uint32_t kept;    /* registers that are multiples of four behind it if they were before */
    uint32_t number;  /* by which Python knows it */
    uint32_t wait;    /* jumps away between two watches of the loop that it jumps back in */
    int64_t next;     /* jumps away, in all, at which the next watch begins */
    uint16_t rest;    /* watches to pass until a proof is tried */
    uint16_t rests;   /* rest to begin with, the next time */
    uint32_t proved;  /* whether the last proof was worth it */
    uint32_t executed;
};

/*
 * A loop that may only wait. Where a turn comes back to its head with the same core registers and flags, has stored
 * nothing and read only what is steady, the next turn is the same, and so on until something happens from outside.
 */
struct watch {
    int64_t head; /* number of the block where turns begin, or NO_HEAD */
    int64_t cycles;
    int64_t instructions; /* totals when the turn began */
    int64_t until;         /* what was read is steady up to here [cycles] */
    struct block *trigger; /* whose jump began it */
    uint32_t turns;       /* that came back and were compared */
    uint32_t blocks;      /* of the turn, in `ran` */
    uint32_t reads;       /* of the turn, in `read` */
    uint32_t counted;     /* what is declared of those that are COUNTED */
    uint32_t changes;     /* whether it may come back with another state, and go on all the same: Python can tell */
    uint32_t end;         /* of the last block in `ran` */
    uint32_t registers[STATE_REGISTERS]; /* when the turn began */
    uint32_t ran[MOST_BLOCKS];           /* twice the number of each block, and one more if it jumped away */
    uint32_t read[MOST_READS];           /* addresses */
};

struct counter {
    int64_t cycles;
    int64_t instructions;
    int64_t deadline;
    int64_t running_number; /* of the block that runs, or -1 */
    int64_t before_number;  /* of the block that ended last, or -1 */
    struct block *running;
    struct block *table;
    int64_t (*runs)[2];     /* how often each block ran, by number: went on behind its end, jumped away */
    uint32_t (*ends)[2];    /* the last instruction of each, and what it may have done: see running_calls.c */
    uint32_t places_mask;   /* places of the table, a power of two, less one */
    uint32_t state;         /* entry of the next block, while no block runs */
    uint32_t reasons;       /* those for which the processor still wants to look */
    uint32_t known_aligned; /* registers known to be multiples of four */
    uint32_t outside;       /* address that is no code of the firmware */
    int32_t stopped;        /* whether the emulator was stopped from here */
    int32_t registers[STATE_REGISTERS]; /* the emulator's numbers of r0 to r14, and of XPSR */
    uint32_t stacks[2][2];  /* the two that the stack pointer was on last: how low it has been on each, and its top */
    uint32_t lowered_from;  /* what the stack pointer was before a block that moved it by some amount; else 0 */
    /* How low the stack pointer has been since running_calls.c asked: before the block that was looked at, and in it. */
    uint32_t lowest[2];
    int (*stop)(void *engine);
    int (*read_register)(void *engine, int number, void *value);
    int (*read_registers)(void *engine, const int *numbers, void **values, int count);
    int (*price)(uint32_t address, uint32_t size, uint32_t state); /* puts a block into the table; 0: it cannot */
    int (*execute)(uint32_t address); /* puts a version of the block that runs into the table, as above; 0: it cannot */
    int (*attend)(uint32_t number);                                /* 0: the block must not run */
    void (*stack)(uint32_t above, uint32_t lowest); /* the stack pointer is on neither, or lower than it was */
    void (*passed)(int64_t turns);                                 /* so often all in `watch.read` was passed over */
    /* How many turns like the one in `watch` follow, what they change being changed already; -1: it cannot tell. */
    int64_t (*prove)(void);
    struct watch watch;
};

/* A range of addresses with peripherals. */
struct window {
    uint64_t base;
    const uint8_t *opened; /* for each of its pages, whether every access is permitted */
    bool (*ask)(void *engine, int access, uint64_t address, int size, int64_t value, void *data);
    int (*read_register)(void *engine, int number, const void *value);
    int (*write_register)(void *engine, int number, const void *value);
    int32_t xpsr; /* the emulator's number of it */
    const uint8_t *const *steady; /* for each page what is declared of its bytes, or NULL: nothing */
    struct counter *counter;      /* that watches loops; NULL: none does */
};

/* The source that this was built from; what is newer or older does not fit accounting in Python. */
const char *hiltest_block_hook_source(void)
{
    return HILTEST_SOURCE_SHA256;
}

/*
 * The emulator writes down where in an IT block the access stands, and forgets to wipe that out: the next block would
 * begin with this one's condition.
 */
static void forget_condition(const struct window *window, void *engine)
{
    uint32_t xpsr = 0;

    (void)window->read_register(engine, window->xpsr, &xpsr);
    if ((xpsr & IT_STATE) != 0) {
        xpsr &= ~IT_STATE;
        (void)window->write_register(engine, window->xpsr, &xpsr);
    }
}

static void end_watch(struct counter *counter, uint32_t wait)
{
    struct watch *watch = &counter->watch;

    if (watch->trigger != NULL) {
        watch->trigger->wait = wait;
        watch->trigger->next = counter->runs[watch->trigger->number][1] + wait;
        watch->trigger = NULL;
    }
    watch->head = NO_HEAD;
    counter->reasons &= ~(uint32_t)WATCHED;
}

/* The turn that runs is not to be compared. */
void hiltest_end_watch(struct counter *counter)
{
    end_watch(counter, counter->watch.trigger != NULL ? counter->watch.trigger->wait : 0);
}

/* The loop does more than wait, now at least: try again after twice as many turns. */
static void give_up(struct counter *counter)
{
    const struct watch *watch = &counter->watch;
    uint32_t longest = watch->reads != 0 ? LONGEST_WAIT_READING : LONGEST_WAIT;
    uint32_t wait = 1;

    if (watch->trigger != NULL) {
        wait = 2 * watch->trigger->wait;
        if (watch->trigger->rest != 0) {
            watch->trigger->rest--;
        }
    }
    end_watch(counter, wait < longest ? wait : longest);
}

/* Take note of an access to a peripheral, and whether what it reads is steady. */
static void note_access(const struct window *window, bool is_write, uint64_t address, int size)
{
    struct counter *counter = window->counter;
    struct watch *watch = &counter->watch;
    uint64_t offset = address - window->base;
    const uint8_t *steady = window->steady[offset >> PAGE_BITS];
    uint32_t declared = STEADY | COUNTED | COUNTS;

    for (int byte = 0; byte < size; byte++) {
        declared &= steady == NULL ? 0 : steady[(offset + (uint64_t)byte) % PAGE_BYTES];
    }
    if ((declared & (STEADY | COUNTS)) == 0 || watch->reads == MOST_READS || is_write) {
        watch->reads++; /* there was one: `give_up` looks */
        give_up(counter);
        return;
    }
    watch->read[watch->reads++] = (uint32_t)address;
    if ((declared & COUNTED) != 0) {
        watch->counted |= declared;
    }
    watch->changes |= declared & COUNTS;
}

/*
 * Whether an access finds a peripheral with a clock. Pages that are known to be open pass; the emulator looks up the
 * exact instruction before it asks, which is why it is made to.
 */
bool hiltest_permit(void *engine, int access, uint64_t address, int size, int64_t value, void *data)
{
    const struct window *window = data;
    uint64_t page = (address - window->base) >> PAGE_BITS;
    uint64_t last = (address - window->base + (uint64_t)size - 1) >> PAGE_BITS;

    bool watched = window->counter != NULL && window->counter->watch.head != NO_HEAD;

    if (page != last || window->opened[page] == 0) { /* an access may straddle two pages */
        if (watched) {
            give_up(window->counter);
        }
        return window->ask(engine, access, address, size, value, NULL);
    }
    if (watched) {
        note_access(window, access == WRITE_NOT_PERMITTED, address, size);
    }
    forget_condition(window, engine);
    return true;
}

static uint32_t place_of(uint32_t address, uint32_t state)
{
    return (address >> 1) + state * 0x9E3779B1u; /* the golden ratio spreads the states of one address */
}

/* Where a block stands, or the free place where it belongs. Python keeps the table at most half full. */
static struct block *
find(const struct counter *counter, uint32_t address, uint32_t size, uint32_t state, uint32_t executed)
{
    uint32_t place = place_of(address + executed, state) & counter->places_mask;

    for (;;) {
        struct block *block = &counter->table[place];

        if (block->size == 0 || (block->address == address && block->entry == state && block->size == size &&
                                 block->executed == executed)) {
            return block;
        }
        place = (place + 1) & counter->places_mask;
    }
}

void hiltest_add_block(struct counter *counter, const struct block *block)
{
    *find(counter, block->address, block->size, block->entry, block->executed) = *block;
}

/* Add the block that ran; `next` is where execution goes on. */
static void finish(struct counter *counter, uint32_t next)
{
    struct block *block = counter->running;

    if (block == NULL) {
        return;
    }
    counter->running = NULL;
    counter->before_number = block->number;
    counter->instructions += block->count;
    counter->known_aligned &= block->kept;
    if (next == block->address + block->size) {
        counter->cycles += block->through;
        counter->state = block->leaves;
        counter->runs[block->number][0]++;
    } else {
        counter->cycles += block->taken;
        counter->state = block->jumps;
        if (++counter->runs[block->number][1] >= block->next && counter->watch.trigger == NULL) {
            counter->watch.trigger = block;
            counter->reasons |= WATCHED;
        }
    }
}

/* The emulator stopped, and `next` is where it will go on; says whether it was stopped from here. */
int hiltest_settle(struct counter *counter, uint32_t next)
{
    int stopped = counter->stopped;
    int64_t before = counter->before_number;
    bool begun = counter->running != NULL && counter->running->address == next;

    counter->stopped = 0;
    finish(counter, next);
    if (begun) { /* it was stopped before its first instruction */
        counter->before_number = before;
    }
    hiltest_end_watch(counter);
    counter->running_number = -1;
    /* What happens now may write registers, save the floating-point state or switch the FPU off. */
    counter->known_aligned = 0;
    counter->reasons |= USES_FPU;
    return stopped;
}

static void stop(struct counter *counter, void *engine)
{
    counter->running_number = -1;
    counter->stopped = 1;
    (void)counter->stop(engine);
}

static bool any_misaligned(const struct counter *counter, void *engine, uint32_t registers)
{
    uint32_t together = 0;

    for (int number = 0; number < CORE_REGISTERS; number++) {
        if (registers >> number & 1) {
            uint32_t value = 0;

            (void)counter->read_register(engine, counter->registers[number], &value);
            together |= value;
        }
    }
    return (together & 3) != 0;
}

/* Whether a block may run; asks the processor where only it can tell. */
static bool may_run(struct counter *counter, void *engine, struct block *block)
{
    uint32_t unknown = block->aligned & ~counter->known_aligned;
    bool ask = (block->reasons & counter->reasons & ~(uint32_t)(WATCHED | STACK_REASONS)) != 0;

    ask = ask || (unknown != 0 && any_misaligned(counter, engine, unknown));
    if (ask && !counter->attend(block->number)) {
        return false;
    }
    counter->known_aligned |= block->aligned;
    counter->reasons &= ~(block->reasons & USES_FPU);
    block->reasons &= ~(uint32_t)(ALIGNMENT_INSIDE | WATCHED_INSIDE); /* is being watched from now on */
    return true;
}

/* Take note of where the stack pointer is, and gets to in a block: `Totals._look_at_stack` of code_hook.py, in C. */
static void look_at_stack(struct counter *counter, void *engine, const struct block *block)
{
    uint32_t at = 0;
    uint32_t above;
    uint32_t lowest;

    (void)counter->read_register(engine, counter->registers[STACK_POINTER], &at);
    above = counter->lowered_from > at ? counter->lowered_from : at;
    lowest = at - block->lowers;
    if (counter->lowest[1] < counter->lowest[0]) {
        counter->lowest[0] = counter->lowest[1];
    }
    counter->lowest[1] = lowest;
    counter->lowered_from = (block->reasons & MOVES_STACK_BY) != 0 ? at : 0;
    counter->reasons &= ~(uint32_t)STACK_MOVED;
    if ((block->reasons & (MOVES_STACK_BY | MOVES_STACK)) != 0) {
        counter->reasons |= STACK_MOVED;
    }
    if ((lowest < counter->stacks[0][0] || above > counter->stacks[0][1]) &&
        (lowest < counter->stacks[1][0] || above > counter->stacks[1][1])) {
        counter->stack(above, lowest);
    }
}

/* Nothing but an interrupt ends it: pass whole rounds at once, up to the next event. */
static void pass_rounds(struct counter *counter, const struct block *block)
{
    int64_t left = counter->deadline - counter->cycles;
    int64_t rounds = left > 0 ? (left + block->taken - 1) / block->taken - 1 : 0;

    counter->cycles += rounds * block->taken;
    counter->instructions += rounds;
    counter->runs[block->number][1] += rounds;
}

static void read_state(struct counter *counter, void *engine, uint32_t *values)
{
    void *places[STATE_REGISTERS];

    for (int number = 0; number < STATE_REGISTERS; number++) {
        places[number] = &values[number];
    }
    (void)counter->read_registers(engine, counter->registers, places, STATE_REGISTERS);
}

static void begin_turn(struct counter *counter, const struct block *block)
{
    struct watch *watch = &counter->watch;

    watch->head = block->number;
    watch->cycles = counter->cycles;
    watch->instructions = counter->instructions;
    watch->blocks = 0;
    watch->reads = 0;
    watch->counted = 0;
    watch->changes = 0;
    watch->until = INT64_MAX;
}

/* Count turns like the one that ended. */
static void pass_turns(struct counter *counter, int64_t turns)
{
    const struct watch *watch = &counter->watch;
    int64_t period = counter->cycles - watch->cycles;

    counter->instructions += turns * (counter->instructions - watch->instructions);
    counter->cycles += turns * period;
    for (uint32_t place = 0; place < watch->blocks; place++) {
        counter->runs[watch->ran[place] >> 1][watch->ran[place] & 1] += turns;
    }
    if (watch->counted != 0) {
        counter->passed(turns);
    }
}

/* How many more turns like the one that ended end before the next event. */
static int64_t turns_left(const struct counter *counter)
{
    int64_t until = counter->deadline < counter->watch.until ? counter->deadline : counter->watch.until;
    int64_t period = counter->cycles - counter->watch.cycles;

    return period > 0 && until > counter->cycles ? (until - 1 - counter->cycles) / period : 0;
}

/* Whether a proof takes the host less than to execute so many turns. */
static bool is_worth_a_proof(const struct counter *counter, int64_t turns)
{
    const struct watch *watch = &counter->watch;

    if (watch->reads != 0) {
        return turns * watch->reads >= FEWEST_READS_PROVED;
    }
    return turns * (counter->cycles - watch->cycles) >= FEWEST_CYCLES_PROVED;
}

/* The turn that ended changed something: have Python prove how many follow that are like it; says whether any do. */
static bool pass_proved_turns(struct counter *counter, const struct block *block)
{
    struct watch *watch = &counter->watch;
    struct block *trigger = watch->trigger;
    uint32_t from = watch->reads != 0 ? PROVED_FROM_READING : PROVED_FROM;
    int longest;
    int64_t turns;

    if (trigger == NULL || trigger->rest != 0 || (trigger->proved == 0 && trigger->wait < from) ||
        (watch->counted & STEADY) != 0 || !is_worth_a_proof(counter, turns_left(counter))) {
        return false;
    }
    counter->running_number = -1; /* it is now when the block begins */
    turns = counter->prove();
    counter->running_number = block->number;
    trigger->proved = is_worth_a_proof(counter, turns);
    if (trigger->proved != 0) {
        trigger->rests = 0;
    } else {
        longest = turns < 0 || watch->reads == 0 ? LONGEST_REST : LONGEST_REST_READING;
        trigger->rests = (uint16_t)(2 * trigger->rests + 1 < longest ? 2 * trigger->rests + 1 : longest);
        trigger->rest = trigger->rests;
    }
    if (turns <= 0) {
        return false;
    }
    pass_turns(counter, turns);
    counter->known_aligned = 0; /* registers have been written */
    end_watch(counter, trigger->proved != 0 ? 1 : trigger->wait);
    return true;
}

/* Compare what a turn came back with; says whether the watch goes on. */
static bool comes_back(struct counter *counter, void *engine, const struct block *block)
{
    struct watch *watch = &counter->watch;
    uint32_t registers[STATE_REGISTERS] = {0};

    if (watch->changes == 0) {
        read_state(counter, engine, registers);
        if (memcmp(registers, watch->registers, sizeof registers) == 0) {
            pass_turns(counter, turns_left(counter));
            end_watch(counter, 1);
            return false;
        }
    }
    watch->turns++;
    if ((watch->changes != 0 || watch->turns > 1) && pass_proved_turns(counter, block)) {
        return false;
    }
    if (watch->changes != 0 || watch->turns == MOST_TURNS) {
        give_up(counter);
        return false;
    }
    if (watch->turns == 1) {
        memcpy(watch->registers, registers, sizeof registers);
        begin_turn(counter, block);
    }
    return true;
}

/* A block is about to run while a loop is watched, or is to be watched from here on. */
static void watch_block(struct counter *counter, void *engine, const struct block *block)
{
    struct watch *watch = &counter->watch;

    if (watch->head == NO_HEAD) {
        watch->turns = 0;
        begin_turn(counter, block);
        if ((block->reasons & MAY_WAIT) != 0) {
            read_state(counter, engine, watch->registers);
        }
    } else {
        watch->ran[watch->blocks - 1] |= block->address != watch->end;
        if (block->number == watch->head && !comes_back(counter, engine, block)) {
            return;
        }
    }
    if ((block->reasons & MAY_WAIT) == 0) {
        watch->changes = 1;
    }
    if ((block->reasons & (MAY_WAIT | MAY_BE_PROVED)) == 0 || watch->blocks == MOST_BLOCKS) {
        give_up(counter);
        return;
    }
    watch->ran[watch->blocks++] = 2 * block->number;
    watch->end = block->address + block->size;
}

/* An instruction that is watched is executed: what runs is from here on the block with that one, skipped or not before. */
void hiltest_executes(void *engine, uint64_t address64, uint32_t length, void *data)
{
    struct counter *counter = data;
    struct watch *watch = &counter->watch;
    uint32_t executed = (uint32_t)address64;
    uint32_t address;
    uint32_t size;
    uint32_t entry;
    struct block *block;

    (void)length;
    if (counter->running == NULL) {
        return;
    }
    address = counter->running->address;
    size = counter->running->size;
    entry = EXECUTING | counter->running->number;
    block = find(counter, address, size, entry, executed);
    if (block->size == 0) {
        if (!counter->execute(executed)) {
            counter->running = NULL; /* it may have been a place of another table */
            stop(counter, engine);
            return;
        }
        block = find(counter, address, size, entry, executed);
    }
    counter->running = block;
    counter->running_number = block->number;
    if (watch->head != NO_HEAD) {
        watch->ran[watch->blocks - 1] = 2 * block->number;
    }
}

/* The emulator is about to run a block: its block hook. */
void hiltest_block_begins(void *engine, uint64_t address64, uint32_t size, void *data)
{
    struct counter *counter = data;
    uint32_t address = (uint32_t)address64;
    uint32_t state;
    struct block *block;

    if (address == counter->outside) {
        return;
    }
    finish(counter, address);
    if (counter->cycles >= counter->deadline) {
        stop(counter, engine);
        return;
    }
    state = counter->state;
    block = find(counter, address, size, state, 0);
    if (block->size == 0) {
        counter->running_number = -1;
        if (!counter->price(address, size, state)) {
            stop(counter, engine);
            return;
        }
        block = find(counter, address, size, state, 0); /* the table may have moved */
    }
    counter->running = block;
    counter->running_number = block->number;
    if ((block->reasons & counter->reasons) != 0 || (block->aligned & ~counter->known_aligned) != 0) {
        if (!may_run(counter, engine, block)) {
            counter->running = NULL;
            stop(counter, engine);
            return;
        }
        if ((block->reasons & counter->reasons & STACK_REASONS) != 0) {
            look_at_stack(counter, engine, block);
        }
        if ((block->reasons & LOOPS_TO_ITSELF) != 0 && (block->jumps == NEUTRAL || block->jumps == state)) {
            pass_rounds(counter, block);
        }
        if ((counter->reasons & WATCHED) != 0) {
            watch_block(counter, engine, block);
        }
    }
    counter->state = NEUTRAL;
}
