/* What the K64F's memories add to an instruction's own cycles: flash behind its controller (FMC), banks that code and
 * data want at once, data at no multiple of its size.
 *
 * A read of the flash array brings one line, and the next line is read ahead at once. What was accessed is kept in a
 * cache of smaller entries. The flash has a clock of its own, and a read begins at one of its edges: a miss costs one
 * flash clock, and up to nearly another one until the edge. The rows of a profile's table [memory] give the numbers.
 */
#ifndef HILTEST_WAITS_H
#define HILTEST_WAITS_H

#include <stdbool.h>
#include <stdint.h>

/* Rows of the table: name, least and largest value, whether it is a power of two. Nothing waits by flash_uncertainty.
 * The profiles allow larger caches than these arrays hold; the K64F has 4 ways of 4 sets. */
enum { CACHE_WAYS = 16, CACHE_SETS = 64 };
#define MEMORY_ROWS(X) \
    X(flash_clocks, 1, 1000, false) X(flash_line_bytes, 4, 512, true) X(flash_read_ahead, 0, 1, false) \
    X(cache_entry_bytes, 4, 512, true) X(cache_ways, 1, CACHE_WAYS, false) X(cache_sets, 1, CACHE_SETS, true) \
    X(lower_single, 0, 1000, false) X(lower_multiple, 0, 1000, false) \
    X(upper_single, 0, 1000, false) X(upper_multiple, 0, 1000, false) \
    X(flash_lower_single, 0, 1000, false) X(flash_lower_multiple, 0, 1000, false) \
    X(flash_uncertainty, 0, 100, false) X(unaligned, 0, 1000, false)
#define MEMORY_ROW_ENUMERATOR(NAME, LEAST, LARGEST, IS_POWER) MEMORY_##NAME,
enum memory_row { MEMORY_ROWS(MEMORY_ROW_ENUMERATOR) MEMORY_ROW_COUNT };

/* Switches of the controller for one half of the flash. An entry of the cache is found there whatever they say. */
struct bank_switches {
    bool keeps_line;                         /* the line that was read last */
    bool reads_ahead_code, reads_ahead_data; /* the next line, behind a fetch or behind an access to data */
    bool caches_code, caches_data;           /* whether what was fetched, or accessed, enters the cache */
};

/* The entry that was used last comes first, the one that gives way next comes last. */
struct cache_set {
    uint32_t entries[CACHE_WAYS];
    uint8_t ways[CACHE_WAYS]; /* where each of them is */
};

struct memory_waits {
    uint32_t half_flash_bytes; /* flash begins at address 0 and has two halves */
    uint32_t ram_end;          /* there are no waits from this address on */
    int32_t value[MEMORY_ROW_COUNT];
    uint32_t line_shift, entry_shift, set_mask; /* from the number of a word to that of its line, entry and set */
    struct bank_switches switches[2];
    int64_t free_at;   /* cycle at which the array can take the next read */
    uint32_t line;     /* that was read last; UINT32_MAX is none, here and below */
    uint32_t ahead;    /* line that is read ahead */
    uint32_t word;     /* that was fetched last: its second instruction is no access */
    int32_t parts_owed;/* hundredths of a cycle of conflicts in SRAM that are not waited for yet */
    struct cache_set sets[CACHE_SETS];
};

/* Begin with the K64F's address map, no waits in SRAM, and everything switched on. */
void waits_begin(struct memory_waits *waits);
/* Set a row by its name; lines and words are forgotten. False, and nothing is set, if no row has that name or the value
 * is out of its range. */
bool set_memory_row(struct memory_waits *waits, const char *row, int32_t value);

/* Forget all lines, entries and words, and that the array is busy: memory was loaded anew. */
void waits_reset(struct memory_waits *waits);
/* Go back to a state with the same rows, or forget everything if there is none. */
void waits_restore(struct memory_waits *waits, const struct memory_waits *state);
/* Forget the line that was read last and the one that was read ahead (PFB0CR.S_B_INV). */
void waits_forget_lines(struct memory_waits *waits);
/* Empty one way of the cache (PFB0CR.CINV_WAY); it is filled next. */
void waits_forget_way(struct memory_waits *waits, uint32_t way);
/* Forget the fetched word: the core jumps. */
void waits_forget_word(struct memory_waits *waits);
/* Forget the fetched word and the parts of a cycle that are owed: an exception comes or goes, or a call begins. */
void waits_flush(struct memory_waits *waits);
/* Set what is done for half 0 or 1 of the flash. */
void waits_switch(struct memory_waits *waits, uint32_t bank, struct bank_switches switches);

/* Cycles that an instruction waits which is fetched at `cycle`; never earlier than the access before. */
int32_t waits_fetch(struct memory_waits *waits, uint32_t address, uint32_t size, int64_t cycle);
/* Whether an instruction would wait for nothing each time it is fetched, if nothing else is. */
bool waits_are_over(const struct memory_waits *waits, uint32_t address, uint32_t size);
/* Cycles that an access to data waits.
 *
 * code_address, words: address of the instruction, and how many words it moves (`words` of struct instruction).
 * first: whether this is the first access of that instruction; only this one meets a fetch. address, size: the data.
 * cycle: what has been counted so far, the waits of this instruction included. */
int32_t waits_access(
    struct memory_waits *waits, uint32_t code_address, uint32_t words, bool first, uint32_t address, uint32_t size,
    int64_t cycle);

#endif
