/* What the files of the core share: the structure that holds a machine. */
#ifndef HILTEST_STATE_H
#define HILTEST_STATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "events.h"
#include "instruction.h"
#include "machine.h"
#include "prices.h"
#include "waits.h"

enum {
    PAGE_BITS = 12, PAGE_BYTES = 1 << PAGE_BITS, PAGES = 1 << (32 - PAGE_BITS), MEMORIES = 16, WATCHPOINTS = 256,
    ANSWERS = 1024,
};

/* The bytes of a page of memory at some moment: the snapshots that have it share it. */
struct page {
    int64_t holders;
    uint8_t bytes[PAGE_BYTES];
};

struct memory {
    uint32_t base, size;
    bool writable;
    uint8_t *bytes;
    uint8_t *has_code; /* for each halfword: whether it was decoded as part of an instruction */
    struct machine_executions *executions; /* for each halfword, see counts.c, or NULL */
    struct page **copies; /* for each page: the copy that equals its bytes, or NULL if there is none, see snapshot.c */
};

struct watchpoint {
    uint32_t address, size, kinds;
};

/* known.c */
enum { KNOWN_ANSWERS = 32, FIRST_PATIENCE = 8, DEVICE_BYTES = 0x100000, DEVICE_PAGES = DEVICE_BYTES / PAGE_BYTES };
#define DEVICE_BASE 0x40000000u
#define PRIVATE_BASE 0xE0000000u

/* What a device has answered to a load by the instruction at `place`. */
struct known_answer {
    int64_t era;         /* it is not known any more if this is not that of all */
    uint32_t address, size, place, value;
    int64_t until;       /* cycle at which it may change */
    int32_t reads;       /* that were answered by it */
    int32_t patience;    /* after so many, see whether they come from a loop that waits */
    bool is_told;        /* the device wants to know of repetitions */
    int64_t repeats;     /* of which it does not know yet */
    int64_t repeated_at; /* number of the last load of them */
};

struct known_answers {
    struct known_answer entries[KNOWN_ANSWERS];
    int64_t era;
    const uint8_t *devices[DEVICE_PAGES], *private_devices[DEVICE_PAGES]; /* see machine_declare_page; NULL: nothing */
    machine_repeated tell;
    void *context;
    bool has_repeats;
    struct known_answer *polled; /* one whose patience is at an end, or NULL */
    int64_t asked;       /* how often devices have been asked */
    int64_t soonest;     /* the first `until` of answers that were recalled, see loops.c */
    uint8_t declared;    /* of the load that a device is asked for */
    int64_t until;       /* cycle at which its answer may change, as the device has said */
};

struct code; /* decoded instructions, see code.h */

enum { MOST_STACKS = 64, CONTEXT_BYTES = 104 }; /* a task's r4 to r11, EXC_RETURN, s16 to s31, and alignment */

struct stacks {
    struct machine_stack entries[MOST_STACKS];
    int32_t count;
    int32_t current;   /* the one that r13 is on */
    uint32_t lowest;   /* address that r13 has had since calls were looked at; 0 if nobody wants to know it */
    bool has_context;
    uint32_t below;    /* address below an exception's frame on the process stack, and what was there */
    uint8_t context[CONTEXT_BYTES];
};

/* What the instructions before the next one have left, beside the core's registers. */
struct history {
    struct pipeline pipeline;
    int64_t jumped_at;   /* core.instructions behind the jump that was taken last */
    uint32_t jumped_from;/* its address */
    uint32_t previous;   /* address of the instruction that led to where there is no code */
    uint32_t exc_return; /* that was branched to */
    uint32_t exclusive_address;
    bool exclusive;      /* the local monitor: an LDREX has been executed */
    uint32_t stack_lowest, stack_used; /* range in which the stack pointer may move unseen, see stacks.c */
    struct stacks stacks;
};

/* loops.c: a loop in which the core has been when somebody looked. */
enum { SHORT_LOOPS = 16, LEAST_LOOKS = 1 };
struct short_loop {
    uint32_t end;     /* address of the branch back, or 0 */
    int32_t looks;    /* at it since turns were passed, or tried */
    int32_t patience; /* after so many, try to pass turns */
};

struct device;
enum { DEVICES = 32 };

struct machine {
    struct core core;
    struct history history;
    struct machine_bus bus;
    struct memory memories[MEMORIES];
    int memory_count;
    /* Bytes of each page that loads may read and stores may write at once; NULL: ask memory.c. */
    uint8_t **readable, **writable;
    struct prices prices;
    struct prices *tables;    /* further price tables, see machine_set_tables */
    int32_t table_count;      /* with `prices`; 0 if they were never asked for */
    struct memory_waits *waits; /* what memories add to instructions; NULL if the profile has no rows of memories */
    struct code *code;
    bool baseline;
    bool looks;          /* an exception may have become deliverable, or code has changed: look before the next
                            instruction */
    bool code_changed;   /* decoded instructions are out of date */
    bool watches_executions;
    bool profiles;       /* a profile is being made, on the path of this number */
    uint32_t path;
    struct profile *profile; /* the latest, or NULL, see profile.c */
    struct watchpoint watchpoints[WATCHPOINTS];
    int watchpoint_count;
    struct calendar calendar;
    struct device *devices[DEVICES]; /* peripherals in C */
    int32_t device_count;
    struct device *dma;  /* the one of them that DMA requests are for, or NULL */
    uint64_t requests;   /* levels of their sources */
    bool has_fired;      /* an event has fired since machine_run was called */
    bool told_host;      /* one that the host may be waiting for */
    struct calls *calls; /* of watched functions; NULL while none is watched, see calls.c */
    uint16_t standing;           /* number of the pipeline states before the next instruction, if `pipeline` is one */
    const struct node *running;  /* the instruction that runs, while a device or whoever watches calls is asked */
    struct known_answers known;
    struct turn *turn;   /* room for the turn of a loop, or NULL, see loops.c */
    struct short_loop short_loops[SHORT_LOOPS];
    uint32_t answers[ANSWERS];   /* what devices have answered to loads: number n is at n % ANSWERS */
    int64_t oldest_answer;       /* number of the first that was kept */
};

/* The bytes of a range that loads may read, or stores may write, at once; NULL if there are none, or it crosses a page. */
static inline const uint8_t *plain_bytes(const struct machine *machine, uint32_t address, uint32_t size)
{
    const uint8_t *page = machine->readable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES <= PAGE_BYTES - size ? page + address % PAGE_BYTES : NULL;
}

static inline uint8_t *writable_bytes(const struct machine *machine, uint32_t address, uint32_t size)
{
    uint8_t *page = machine->writable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES <= PAGE_BYTES - size ? page + address % PAGE_BYTES : NULL;
}

/* memory.c: accesses of the core. On a fault core.fault is set and they return false; nothing is written then. */
bool load(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value);
bool store(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);
struct memory *memory_at(struct machine *machine, uint32_t address, uint32_t size);
/* Read a halfword of code; false where there is no memory. */
bool fetch(struct machine *machine, uint32_t address, uint16_t *halfword);
/* Take note that an instruction was decoded from some bytes, and that none is any more: a store there sets
 * `code_changed`. */
void mark_code(struct machine *machine, uint32_t address, uint32_t size);
void unmark_code(struct machine *machine);
/* Have loads and stores reach the bytes of a page at once, unless somebody has to look at them. */
void open_page(struct machine *machine, const struct memory *memory, uint32_t offset);

/* known.c: answer a load of a device without asking it; false if it has to be asked. */
bool recall_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value);
/* A device is about to be asked; keep its answer. */
void expect_answer(struct machine *machine, uint32_t address, uint32_t size);
void remember_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);
/* For a device that is being read: the answer holds up to a cycle. */
void hold_answer(struct machine *machine, int64_t until);
/* Devices may have changed: ask them again. */
void forget_answers(struct machine *machine);
/* Tell devices of repeated loads, before anything else that they get to know. */
void tell_repeats(struct machine *machine);

/* loops.c: execute a turn of a loop that polls a device or memory, and count turns that are like it up to a cycle.
 * *patience, which says how soon to try again, becomes `least` if that has saved time, and grows if not. Returns a reason
 * to stop, or -1. */
int32_t pass_turns(struct machine *machine, int64_t until, int32_t *patience, int32_t least);
/* Whether the core is in a short loop that stores nothing, and may wait for memory to change: its patience if that is at
 * an end, else NULL. */
int32_t *patience_in_loop(struct machine *machine);

/* snapshot.c: whether there was room for what a new memory needs. */
bool begin_copies(struct memory *memory);
/* Take note that bytes of a memory are written. */
void drop_copies(struct machine *machine, struct memory *memory, uint32_t offset, uint32_t size);
void destroy_copies(struct memory *memory);

/* calls.c: the instruction of a watched address is about to execute. */
struct node;
void calls_arrive(struct machine *machine, const struct node *node);
/* An exception was entered, or left by the instruction at `place`; before the cycles of that are counted. `frame` is the
 * address of the registers with flags: it lies at a multiple of eight. */
enum { FRAME_ON_PROCESS_STACK = 1, FRAME_OF_THREAD = 2 };
void calls_entered(struct machine *machine, uint32_t frame);
void calls_left(struct machine *machine, uint32_t frame, int32_t cycles, uint32_t place);
/* The processor was reset: no call that is under way will return. */
void calls_reset(struct machine *machine);
void calls_destroy(struct machine *machine);

/* devices.c */
void forget_devices(struct machine *machine);
/* Copy all peripherals, to go back to them on the same machine; NULL if there is no memory. The copy is to be freed. */
struct device_states *copy_devices(const struct machine *machine);
void restore_devices(struct machine *machine, const struct device_states *states);

/* exceptions.c */
enum { PRIORITY_IDLE = 256 };
/* Note a fault of the instruction at `place`, unless one is noted already. */
void note_fault(
    struct machine *machine, int32_t kind, int32_t cause, uint32_t place, uint32_t address, uint32_t value,
    uint32_t size);
/* Enter the most urgent pending exception if it pre-empts what runs. False: nothing was entered. Afterwards core.fault
 * may be set: what went wrong on the way in. */
bool take_exception(struct machine *machine);
/* Return from the exception that runs by an EXC_RETURN; `place` is the branch. False: core.fault is set. */
bool leave_exception(struct machine *machine, uint32_t exc_return, uint32_t place);
/* Whether an exception would wake the core from WFI (PRIMASK does not hold it back) or, for_event, from WFE. */
bool is_woken(struct machine *machine, bool for_event);

/* nvic.c: what entries and returns do to the sets of exceptions. */
/* Make an exception active; it is not pending any more. */
void begin_exception(struct core *core, int32_t exception);
/* End the exception that became active last. An interrupt whose line is still high becomes pending again. */
void end_exception(struct core *core);
/* The exception that became active last, or EXCEPTION_NONE. */
int32_t last_active(const struct core *core);
/* Number of active exceptions, within the bounds of the list. */
int32_t active_exceptions(const struct core *core);

#endif
