/* The structure of the machine, and functions that files of the core share. */
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

/* Content of a page of memory, which snapshots share. */
struct page {
    int64_t holders;
    uint8_t bytes[PAGE_BYTES];
};

struct memory {
    uint32_t base, size;
    bool writable;
    bool is_alias;     /* all pointers are another memory's */
    uint8_t *bytes;
    uint8_t *has_code; /* for each halfword: true if it was decoded as part of an instruction */
    struct machine_executions *executions; /* for each halfword, see counts.c, or NULL */
    struct page **copies; /* for each page: a copy with the same content, or NULL, see snapshot.c */
};

struct watchpoint {
    uint32_t address, size, kinds;
};

/* known.c */
enum { KNOWN_ANSWERS = 32, FIRST_PATIENCE = 8, DEVICE_BYTES = 0x100000, DEVICE_PAGES = DEVICE_BYTES / PAGE_BYTES };
#define DEVICE_BASE 0x40000000u
#define PRIVATE_BASE 0xE0000000u

/* Value that a device has returned to a load by the instruction at `place`. */
struct known_answer {
    int64_t era;         /* the answer is outdated if this differs from the current era */
    uint32_t address, size, place, value;
    int64_t until;       /* cycle at which the answer may change */
    int32_t reads;       /* loads that it has answered */
    int32_t patience;    /* number of reads after which to check for a waiting loop */
    bool counts_repeats; /* repetitions are counted, see stored.c */
    int64_t repeats;     /* repetitions that were not counted yet */
    int64_t repeated_at; /* number of the last repeated load */
};

struct known_answers {
    struct known_answer entries[KNOWN_ANSWERS];
    int64_t era;
    const uint8_t *devices[DEVICE_PAGES], *private_devices[DEVICE_PAGES]; /* see machine_declare_page, or NULL */
    bool has_repeats;
    struct known_answer *polled; /* an answer with exhausted patience, or NULL */
    int64_t asked;       /* number of loads that devices have answered */
    int64_t soonest;     /* earliest `until` of the cached answers that were used, see loops.c */
    uint8_t declared;    /* declaration of the bytes of the current load */
    int64_t until;       /* cycle at which the answer to the current load may change, according to the device */
};

struct code; /* decoded instructions, see code.h */

enum { MOST_STACKS = 64, CONTEXT_BYTES = 104 }; /* a task's r4 to r11, EXC_RETURN, s16 to s31, and alignment */

struct stacks {
    struct machine_stack entries[MOST_STACKS];
    int32_t count;
    int32_t current;   /* index of the stack in use */
    uint32_t lowest;   /* lowest value of r13 since the last check of calls; 0 if it is not recorded */
    bool has_context;
    uint32_t below;    /* address below an exception's frame on the process stack */
    uint8_t context[CONTEXT_BYTES]; /* bytes there at the exception's entry */
};

/* State that earlier instructions leave for the next one, in addition to the core's registers. */
struct history {
    struct pipeline pipeline;
    uint32_t accessed_at; /* address of the latest access to data by a load or store of one word */
    int64_t jumped_at;   /* core.instructions after the last taken jump */
    uint32_t jumped_from;/* address of that jump */
    uint32_t previous;   /* address of the instruction whose successor has no code */
    uint32_t exc_return; /* target of a branch to EXC_RETURN */
    uint32_t exclusive_address;
    bool exclusive;      /* the local monitor: an LDREX has been executed */
    uint32_t stack_lowest, stack_used; /* range in which the stack pointer moves without a check, see stacks.c */
    struct stacks stacks;
};

/* loops.c: a short loop in which the core was when it was sampled. */
enum { SHORT_LOOPS = 16, LEAST_SAMPLES = 1 };
struct short_loop {
    uint32_t end;     /* address of the branch back, or 0 */
    int32_t samples;  /* number of samples since the last attempt to skip turns */
    int32_t patience; /* number of samples after which to attempt it */
};

struct device;
enum { DEVICES = 64, BLOCKS = 16, BUS_REGIONS = 4 };

/* stored.c */
enum { LOGGED_ACCESSES = 256 };
struct access_log {
    struct machine_access entries[LOGGED_ACCESSES]; /* by address and instruction; size 0 if there is none */
    int32_t latest;
    int64_t writes;
    bool is_paused;
    machine_accessed report;
    void *context;
};

struct machine {
    struct core core;
    struct history history;
    struct machine_bus bus;
    struct memory memories[MEMORIES];
    int memory_count;
    /* Bytes of each page that loads may read and stores may write directly; NULL if memory.c must be called. */
    uint8_t **readable, **writable;
    struct prices prices;
    struct prices *tables;    /* further price tables, see machine_set_tables */
    int32_t table_count;      /* including `prices`; 0 before the first request for tables */
    struct { uint32_t base, size; } regions[BUS_REGIONS]; /* see machine_add_device_region */
    int32_t region_count;
    bool passes_flash_stores; /* see machine_pass_flash_stores */
    uint32_t blocks[BLOCKS];  /* first addresses of memory blocks, in any order */
    uint32_t block_count;
    struct memory_waits *waits; /* waits for memories; NULL if the profile has no memory rows */
    struct code *code;
    bool baseline;
    bool must_check;     /* an exception may have become deliverable, or code has changed */
    bool code_changed;   /* decoded instructions are outdated */
    bool watches_executions;
    bool profiles;       /* a profile is being made, on the path with this number */
    uint32_t path;
    struct profile *profile; /* the latest profile, or NULL, see profile.c */
    struct watchpoint watchpoints[WATCHPOINTS];
    int watchpoint_count;
    struct calendar calendar;
    struct device *devices[DEVICES]; /* peripherals in C */
    int32_t device_count;
    uint8_t first_on_page[DEVICE_PAGES]; /* one more than the index of the page's first device; 0 if there is none */
    struct device *sysmpu; /* system memory protection, or NULL */
    bool protects;       /* it refuses some accesses: pages are closed, so that each access is checked */
    struct device *dma[2]; /* the devices that receive DMA requests, or NULL */
    uint64_t requests;   /* levels of the request sources */
    bool has_fired;      /* an event has fired since the call of machine_run */
    bool host_notified;  /* an event has fired that the host may wait for */
    struct calls *calls; /* calls of watched functions; NULL without any, see calls.c */
    uint16_t standing;           /* number of the pipeline state before the next instruction, if it has a number */
    const struct node *running;  /* the current instruction, during callbacks of devices and of watched calls */
    struct known_answers answer_cache;
    struct turn *turn;   /* buffer for a turn of a loop, or NULL, see loops.c */
    struct short_loop short_loops[SHORT_LOOPS];
    struct access_log accesses;
    uint32_t answers[ANSWERS];   /* answers of devices to loads: number n is at n % ANSWERS */
    int64_t oldest_answer;       /* number of the oldest stored answer */
};

/* Return the bytes of a range that loads may read directly; NULL if they must not, or if the range crosses pages. */
static inline const uint8_t *plain_bytes(const struct machine *machine, uint32_t address, uint32_t size)
{
    const uint8_t *page = machine->readable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES <= PAGE_BYTES - size ? page + address % PAGE_BYTES : NULL;
}

/* The same for stores. */
static inline uint8_t *writable_bytes(const struct machine *machine, uint32_t address, uint32_t size)
{
    uint8_t *page = machine->writable[address >> PAGE_BITS];
    return page && address % PAGE_BYTES <= PAGE_BYTES - size ? page + address % PAGE_BYTES : NULL;
}

/* memory.c: accesses of the core. On a fault they set core.fault, write nothing and return false. */
bool load(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value);
bool store(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);
struct memory *memory_at(struct machine *machine, uint32_t address, uint32_t size);
/* Return whether two addresses are in one memory block, see machine_add_block. */
bool is_same_block(const struct machine *machine, uint32_t one, uint32_t other);
/* Read a halfword of code; false without memory. */
bool fetch(struct machine *machine, uint32_t address, uint16_t *halfword);
/* Mark bytes from which an instruction was decoded, or unmark all bytes. A store to marked bytes sets
 * `code_changed`. */
void mark_code(struct machine *machine, uint32_t address, uint32_t size);
void unmark_code(struct machine *machine);
/* Let loads and stores access the bytes of a page directly, unless they must be checked. */
void open_page(struct machine *machine, const struct memory *memory, uint32_t offset);
void open_all_pages(struct machine *machine);
/* sysmpu.c: close or open all pages after a change of the rights. */
void update_protection(struct machine *machine);
/* Return whether the core may access memory while `protects` is set; otherwise record the error in the registers. */
bool is_permitted(struct machine *machine, uint32_t address, uint32_t size, bool writes);

/* known.c: answer a load from a device by a cached value; false if the device has to be read. */
bool recall_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t *value);
/* Prepare for caching the answer of a device, before the device is read. */
void expect_answer(struct machine *machine, uint32_t address, uint32_t size);
void remember_answer(struct machine *machine, uint32_t address, uint32_t size, uint32_t value);
/* For a device during a load: the answer is valid up to a cycle. */
void hold_answer(struct machine *machine, int64_t until);
/* Drop the cached answers, because devices may have changed. */
void forget_answers(struct machine *machine);
/* stored.c: count accesses; `place` is 0 for the current instruction. */
void count_accesses(struct machine *machine, struct machine_access access);
/* Count repeated loads of registers that are not modelled; must be called before any other access to them. */
void report_repeats(struct machine *machine);

/* loops.c: execute one turn of a loop that polls a device or memory, and count the equal turns up to a cycle without
 * executing them. *patience, the delay of the next attempt, becomes `least` on success and grows otherwise. Returns an
 * enum stop_reason, or -1. */
int32_t pass_turns(struct machine *machine, int64_t until, int32_t *patience, int32_t least);
/* If the core is in a short loop that stores nothing and may wait for a change of memory, and the loop's patience is
 * exhausted, return the patience; otherwise NULL. */
int32_t *patience_in_loop(struct machine *machine);

/* snapshot.c: prepare a new memory for snapshots; false if out of memory. */
bool begin_copies(struct memory *memory);
/* Drop the copies of pages, because their bytes are written. */
void drop_copies(struct machine *machine, struct memory *memory, uint32_t offset, uint32_t size);
void destroy_copies(struct memory *memory);

/* calls.c: called before the instruction at a watched address executes. */
struct node;
void calls_arrive(struct machine *machine, const struct node *node);
/* Called when an exception is entered, or left by the instruction at `place`, before the cycles of the entry or return
 * are counted. `frame` is the address of the stacked registers, a multiple of eight, with flags in its low bits. */
enum { FRAME_ON_PROCESS_STACK = 1, FRAME_OF_THREAD = 2 };
void calls_entered(struct machine *machine, uint32_t frame);
void calls_left(struct machine *machine, uint32_t frame, int32_t cycles, uint32_t place);
/* Abandon all open calls after a reset of the processor. */
void calls_reset(struct machine *machine);
void calls_destroy(struct machine *machine);

/* devices.c */
void forget_devices(struct machine *machine);
/* Copy all peripherals, to restore them in the same machine; NULL if out of memory. The caller frees the copy. */
struct device_states *copy_devices(const struct machine *machine);
void restore_devices(struct machine *machine, const struct device_states *states);

/* exceptions.c */
enum { PRIORITY_IDLE = 256 };
/* Record a fault of the instruction at `place`, unless a fault is already recorded. */
void note_fault(
    struct machine *machine, int32_t kind, int32_t cause, uint32_t place, uint32_t address, uint32_t value,
    uint32_t size);
/* Enter the most urgent pending exception if it preempts the running code. False if none was entered; if the entry
 * faulted, core.fault is set. */
bool take_exception(struct machine *machine);
/* Return from the active exception by an EXC_RETURN; `place` is the branch. False if core.fault was set. */
bool leave_exception(struct machine *machine, uint32_t exc_return, uint32_t place);
/* Return whether an exception would wake the core from WFI, regardless of PRIMASK, or, for_event, from WFE. */
bool is_woken(struct machine *machine, bool for_event);

/* nvic.c: effects of entries and returns on the sets of exceptions. */
/* Make an exception active instead of pending. */
void begin_exception(struct core *core, int32_t exception);
/* End the exception that became active last. An interrupt whose line is still high becomes pending again. */
void end_exception(struct core *core);
/* Return the exception that became active last, or EXCEPTION_NONE. */
int32_t last_active(const struct core *core);
/* Return the number of active exceptions, at most the size of the list. */
int32_t active_exceptions(const struct core *core);

#endif
