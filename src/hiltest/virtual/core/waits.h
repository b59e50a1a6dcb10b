/* Waits of a part's memories, which add to an instruction's own cycles: for flash and its controller, for conflicts of
 * code and data in one bank, for RAM that answers late, and for unaligned data.
 *
 * A read of the flash array returns one line, and the next line is then prefetched. A cache of smaller entries keeps
 * accessed words. Flash with a clock of its own begins a read at an edge of that clock: a miss costs one flash clock,
 * plus the time to the edge. A read of synchronous flash takes its clocks, of which the first one is the fetch's own.
 * The numbers are the rows of a profile's table [memory].
 */
#ifndef HILTEST_WAITS_H
#define HILTEST_WAITS_H

#include <stdbool.h>
#include <stdint.h>

#define SYSTEM_BUS 0x20000000u /* the code buses end and the system bus begins at this address (DDI 0403E, B3.1) */

/* Rows of the table: name, smallest and largest value, and whether it is a power of two. flash_uncertainty causes no
 * waits. */
enum { CACHE_WAYS = 16, CACHE_SETS = 64, LATE_RAMS = 4 };
#define MEMORY_ROWS(X) \
    X(flash_clocks, 1, 1000, false) X(flash_line_bytes, 4, 512, true) X(flash_read_ahead, 0, 1, false) \
    X(cache_entry_bytes, 4, 512, true) X(cache_ways, 1, CACHE_WAYS, false) X(cache_sets, 1, CACHE_SETS, true) \
    X(lower_single, 0, 1000, false) X(lower_multiple, 0, 1000, false) \
    X(upper_single, 0, 1000, false) X(upper_multiple, 0, 1000, false) \
    X(flash_lower_single, 0, 1000, false) X(flash_lower_multiple, 0, 1000, false) \
    X(flash_uncertainty, 0, 100, false) X(unaligned, 0, 1000, false) X(flash_synchronous, 0, 1, false) \
    X(flash_load, 0, 1000, false) X(late_access, 0, 1000, false) \
    X(system_fetch, 0, 1000, false)
#define MEMORY_ROW_ENUMERATOR(NAME, LEAST, LARGEST, IS_POWER) MEMORY_##NAME,
enum memory_row { MEMORY_ROWS(MEMORY_ROW_ENUMERATOR) MEMORY_ROW_COUNT };

/* Switches of the controller for one half of the flash, which do not affect hits in the cache. */
struct bank_switches {
    bool keeps_line;                         /* the line that was read last */
    bool reads_ahead_code, reads_ahead_data; /* prefetch after a fetch, or after an access to data */
    bool caches_code, caches_data;           /* fetched words, or accessed data, enter the cache */
};

/* Entries in order of their last use, with the most recent one first; the last one is replaced next. */
struct cache_set {
    uint32_t entries[CACHE_WAYS];
    uint8_t ways[CACHE_WAYS]; /* way of each entry */
};

struct address_range {
    uint32_t begin, bytes;
};

struct memory_waits {
    struct address_range flash; /* its two halves have switches of their own */
    struct address_range late[LATE_RAMS]; /* RAMs that answer late */
    uint32_t late_count;
    int64_t bus_free_at; /* cycle at which the system bus has done all transfers, while code is fetched over it */
    int64_t jumped_at;   /* cycle of the latest jump, before which its target cannot be fetched */
    bool has_conflicts; /* of code and data in one bank, or memory rows of unaligned data */
    bool store_hidden; /* the latest store to a late RAM has begun a group, and has not waited */
    int32_t value[MEMORY_ROW_COUNT];
    uint32_t line_shift, entry_shift, set_mask; /* convert the number of a word to those of its line, entry and set */
    struct bank_switches switches[2];
    int64_t free_at;   /* cycle at which the array can take the next read */
    uint32_t line;     /* last line read; here and below UINT32_MAX means none */
    uint32_t ahead;    /* prefetched line */
    uint32_t word;     /* last word fetched: its second instruction needs no access */
    int32_t parts_owed;/* conflicts in SRAM that were not added yet [hundredths of a cycle] */
    struct cache_set sets[CACHE_SETS];
};

/* Begin with the K64F's flash, no waits in SRAM, and all functions of the controller enabled. */
void waits_begin(struct memory_waits *waits);
/* Set the place of the flash, or add a RAM that answers late; false if there are too many of these. */
void waits_set_flash(struct memory_waits *waits, struct address_range flash);
bool waits_add_late_ram(struct memory_waits *waits, struct address_range ram);
/* Set a row by its name, and drop lines and words. False, with no effect, if no row has that name or the value
 * is out of its range. */
bool set_memory_row(struct memory_waits *waits, const char *row, int32_t value);

/* Drop all lines, entries and words, and end reads, because memory was reloaded. */
void waits_reset(struct memory_waits *waits);
/* Restore a state with the same rows; with NULL, drop all lines, entries and words. */
void waits_restore(struct memory_waits *waits, const struct memory_waits *state);
/* Drop the last line read and the prefetched one (PFB0CR.S_B_INV). */
void waits_forget_lines(struct memory_waits *waits);
/* Empty one way of the cache (PFB0CR.CINV_WAY), which is then filled next. */
void waits_forget_way(struct memory_waits *waits, uint32_t way);
/* Drop the fetched word and the owed parts of a cycle, at an exception's entry or return or before a call. */
void waits_flush(struct memory_waits *waits);
/* Set the switches of half 0 or 1 of the flash. */
void waits_switch(struct memory_waits *waits, uint32_t bank, struct bank_switches switches);

/* Return whether instructions at an address may wait for their fetch. */
bool fetches_wait(const struct memory_waits *waits, uint32_t address);
/* Return the wait of an instruction that is fetched at `cycle` [cycles]. Cycles of successive accesses must not
 * decrease. */
int32_t waits_fetch(struct memory_waits *waits, uint32_t address, uint32_t size, int64_t cycle);
/* Drop the fetched word, because the core jumps at `cycle`. */
void waits_jump(struct memory_waits *waits, int64_t cycle);
/* Return whether an instruction that is fetched repeatedly never waits. */
bool waits_are_over(const struct memory_waits *waits, uint32_t address, uint32_t size);
/* Return the wait of an access to data [cycles].
 *
 * code_address, words: address of the instruction, and number of words that it transfers (`words` of struct
 * instruction). first: true for the first access of the instruction, the only one that conflicts with a fetch. role:
 * enum access_role. address, size: the data. cycle: the count so far, including the waits of this instruction. */
int32_t waits_access(
    struct memory_waits *waits, uint32_t code_address, uint32_t words, bool first, uint8_t role, uint32_t address,
    uint32_t size, int64_t cycle);
/* The same for all words of a transfer from or to an address on. */
int32_t waits_transfer(
    struct memory_waits *waits, uint32_t code_address, uint32_t words, uint8_t role, uint32_t address, int64_t cycle);

#endif
