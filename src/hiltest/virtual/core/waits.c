/* Waits of a part's memories. */
#include "waits.h"

#include "prices.h"

#include <string.h>

#define NOTHING UINT32_MAX

/* Fetches read words. */
enum { WORD_BYTES = 4, WORD_BITS = 2 };
enum { FETCHED_AHEAD = 3 }; /* words that the core holds before it executes them */
enum { PARTS = 100 }; /* conflicts cost hundredths of a cycle per access: their mean, which was measured */

#define BIT_BAND_ALIASES 0x22000000u /* no waits from this address on */
#define K64F_FLASH_BYTES 0x100000u

/* --- Rows --------------------------------------------------------------------------------------------------------- */

struct row_range {
    const char *name;
    int32_t least, largest;
    bool is_power;
};
#define MEMORY_ROW_RANGE(NAME, LEAST, LARGEST, IS_POWER) {#NAME, LEAST, LARGEST, IS_POWER},
static const struct row_range RANGES[MEMORY_ROW_COUNT] = {MEMORY_ROWS(MEMORY_ROW_RANGE)};

static bool is_allowed(const struct row_range *range, int32_t value)
{
    bool is_power = (value & (value - 1)) == 0;
    return value >= range->least && value <= range->largest && (is_power || !range->is_power);
}

/* Logarithm of a power of two. */
static uint32_t bits_of(int32_t power)
{
    uint32_t bits = 0;
    while (bits < 31 && power >> bits != 1)
        bits++;
    return bits;
}

/* Set the geometry of lines and cache from the rows. */
static void set_geometry(struct memory_waits *waits)
{
    waits->line_shift = bits_of(waits->value[MEMORY_flash_line_bytes]) - WORD_BITS;
    waits->entry_shift = bits_of(waits->value[MEMORY_cache_entry_bytes]) - WORD_BITS;
    waits->set_mask = (uint32_t)waits->value[MEMORY_cache_sets] - 1;
    waits->has_conflicts = waits->value[MEMORY_unaligned];
    for (int row = MEMORY_lower_single; row <= MEMORY_flash_lower_multiple; row++)
        waits->has_conflicts |= waits->value[row] > 0;
    waits_reset(waits);
}

void waits_begin(struct memory_waits *waits)
{
    const struct bank_switches all_on = {true, true, true, true, true};
    memset(waits, 0, sizeof *waits);
    waits->flash.bytes = K64F_FLASH_BYTES;
    waits->switches[0] = waits->switches[1] = all_on;
    for (int row = 0; row < MEMORY_ROW_COUNT; row++)
        waits->value[row] = RANGES[row].least;
    set_geometry(waits);
}

void waits_set_flash(struct memory_waits *waits, struct address_range flash)
{
    waits->flash = flash;
    waits_reset(waits);
}

bool waits_add_late_ram(struct memory_waits *waits, struct address_range ram)
{
    if (waits->late_count == LATE_RAMS)
        return false;
    waits->late[waits->late_count++] = ram;
    return true;
}

bool set_memory_row(struct memory_waits *waits, const char *row, int32_t value)
{
    for (int i = 0; i < MEMORY_ROW_COUNT; i++) {
        if (strcmp(RANGES[i].name, row) == 0) {
            if (!is_allowed(&RANGES[i], value))
                return false;
            waits->value[i] = value;
            set_geometry(waits);
            return true;
        }
    }
    return false;
}

static bool is_in_range(const struct address_range *range, uint32_t address)
{
    return address - range->begin < range->bytes;
}

/* --- State -------------------------------------------------------------------------------------------------------- */

void waits_reset(struct memory_waits *waits)
{
    uint32_t ways = (uint32_t)waits->value[MEMORY_cache_ways];
    for (uint32_t set = 0; set < CACHE_SETS; set++) {
        for (uint32_t place = 0; place < ways; place++) {
            waits->sets[set].entries[place] = NOTHING;
            waits->sets[set].ways[place] = (uint8_t)(ways - 1 - place); /* way 0 is filled first */
        }
    }
    waits->free_at = waits->bus_free_at = waits->jumped_at = 0;
    waits_forget_lines(waits);
    waits->word = NOTHING;
}

void waits_restore(struct memory_waits *waits, const struct memory_waits *state)
{
    if (state && memcmp(waits->value, state->value, sizeof waits->value) == 0) {
        *waits = *state;
    } else {
        waits_reset(waits);
        waits_flush(waits);
    }
}

void waits_forget_lines(struct memory_waits *waits) { waits->line = waits->ahead = NOTHING; }

void waits_flush(struct memory_waits *waits)
{
    waits->parts_owed = 0; /* otherwise a call would depend on the calls before it */
    waits->word = NOTHING;
}

static void empty_way(struct cache_set *set, uint32_t way, uint32_t ways)
{
    uint32_t place = 0;
    while (place < ways && set->ways[place] != way)
        place++;
    if (place == ways)
        return;
    for (; place < ways - 1; place++) {
        set->entries[place] = set->entries[place + 1];
        set->ways[place] = set->ways[place + 1];
    }
    set->entries[place] = NOTHING;
    set->ways[place] = (uint8_t)way;
}

void waits_forget_way(struct memory_waits *waits, uint32_t way)
{
    for (uint32_t set = 0; set <= waits->set_mask; set++)
        empty_way(&waits->sets[set], way, (uint32_t)waits->value[MEMORY_cache_ways]);
}

void waits_switch(struct memory_waits *waits, uint32_t bank, struct bank_switches switches)
{
    if (bank > 1)
        return;
    if (waits->switches[bank].keeps_line && !switches.keeps_line)
        waits->line = NOTHING;
    waits->switches[bank] = switches;
}

/* --- Flash -------------------------------------------------------------------------------------------------------- */

static int64_t next_edge(const struct memory_waits *waits, int64_t cycle)
{
    int64_t clocks = waits->value[MEMORY_flash_clocks];
    int64_t earliest = cycle > waits->free_at ? cycle : waits->free_at;
    return waits->value[MEMORY_flash_synchronous] ? earliest : (earliest + clocks - 1) / clocks * clocks;
}

/* Read a line from the array, unless it is the prefetched one; return the wait. */
static int32_t read_line(struct memory_waits *waits, uint32_t line, int64_t cycle, bool keeps, bool reads_ahead)
{
    int64_t clocks = waits->value[MEMORY_flash_clocks] - waits->value[MEMORY_flash_synchronous];
    int64_t ready = next_edge(waits, cycle) + clocks;
    if (line == waits->ahead) /* it is available when the array is free again */
        ready = cycle > waits->free_at ? cycle : waits->free_at;
    waits->line = keeps ? line : NOTHING;
    waits->ahead = NOTHING;
    waits->free_at = ready;
    if (reads_ahead) {
        waits->ahead = line + 1;
        waits->free_at = next_edge(waits, ready) + clocks;
    }
    return (int32_t)(ready - cycle);
}

/* Replace the entry at a place, and move the place to the front. */
static void use_entry(struct cache_set *set, uint32_t place, uint32_t entry)
{
    uint8_t way = set->ways[place];
    for (; place > 0; place--) {
        set->entries[place] = set->entries[place - 1];
        set->ways[place] = set->ways[place - 1];
    }
    set->entries[0] = entry;
    set->ways[0] = way;
}

/* Return whether the entry of a word is the most recent one of its set: it neither waits nor changes anything. */
static bool is_used_last(const struct memory_waits *waits, uint32_t word)
{
    uint32_t entry = word >> waits->entry_shift;
    return waits->sets[entry & waits->set_mask].entries[0] == entry;
}

/* Return the wait for a word whose entry is not the most recent one. */
static int32_t wait_for_word(
    struct memory_waits *waits, uint32_t word, int64_t cycle, const struct bank_switches *switches, bool is_fetched)
{
    uint32_t entry = word >> waits->entry_shift, line = word >> waits->line_shift;
    struct cache_set *set = &waits->sets[entry & waits->set_mask];
    uint32_t ways = (uint32_t)waits->value[MEMORY_cache_ways], place = 0;
    while (place < ways && set->entries[place] != entry)
        place++;
    bool is_cached = place < ways;
    int32_t wait = 0;
    if (!is_cached && line != waits->line && !(is_fetched && word == waits->word)) {
        bool ahead = is_fetched ? switches->reads_ahead_code : switches->reads_ahead_data;
        ahead = ahead && waits->value[MEMORY_flash_read_ahead];
        wait = read_line(waits, line, cycle, switches->keeps_line, ahead);
    }
    if (is_cached)
        use_entry(set, place, entry);
    else if (is_fetched ? switches->caches_code : switches->caches_data)
        use_entry(set, ways - 1, entry);
    return wait;
}

static bool is_flash(const struct memory_waits *waits, uint32_t address)
{
    return is_in_range(&waits->flash, address);
}

/* Access the words from `first` to `last`; an instruction or data may straddle two words, and two lines. */
static int32_t wait_for_words(struct memory_waits *waits, uint32_t first, uint32_t last, int64_t cycle, bool is_fetched)
{
    const bool is_upper_half = first * WORD_BYTES - waits->flash.begin >= waits->flash.bytes / 2;
    const struct bank_switches *switches = &waits->switches[is_upper_half];
    int32_t wait = 0;
    for (uint32_t word = first; word <= last; word++) {
        if (!is_used_last(waits, word))
            wait += wait_for_word(waits, word, cycle + wait, switches, is_fetched);
        if (is_fetched)
            waits->word = word;
    }
    return wait;
}

static inline int32_t wait_for_flash(
    struct memory_waits *waits, uint32_t address, uint32_t size, int64_t cycle, bool is_fetched)
{
    uint32_t first = address / WORD_BYTES, last = (address + size - 1) / WORD_BYTES;
    if (first != last || !is_used_last(waits, first))
        return wait_for_words(waits, first, last, cycle, is_fetched);
    if (is_fetched)
        waits->word = first;
    return 0; /* by far the most frequent case */
}

/* Return whether a read of the flash takes longer than a fetch. */
static bool is_flash_slow(const struct memory_waits *waits)
{
    return !waits->value[MEMORY_flash_synchronous] || waits->value[MEMORY_flash_clocks] > 1;
}

/* The core fetches ahead of what it executes while the bus is free, but not before a jump to it. */
static int64_t earliest_fetch(const struct memory_waits *waits, int64_t cycle)
{
    int64_t ahead = cycle - FETCHED_AHEAD * (int64_t)waits->value[MEMORY_system_fetch];
    return ahead > waits->jumped_at ? ahead : waits->jumped_at;
}

/* Fetch the words of an instruction over the system bus, which carries data, too; return the wait for the last one. */
static int32_t wait_for_system_bus(struct memory_waits *waits, uint32_t address, uint32_t size, int64_t cycle)
{
    const int64_t earliest = earliest_fetch(waits, cycle);
    uint32_t last = (address + size - 1) / WORD_BYTES;
    for (uint32_t word = address / WORD_BYTES; word <= last; word++) {
        if (word == waits->word)
            continue;
        waits->word = word;
        waits->bus_free_at = (waits->bus_free_at > earliest ? waits->bus_free_at : earliest)
            + waits->value[MEMORY_system_fetch];
    }
    return waits->bus_free_at > cycle ? (int32_t)(waits->bus_free_at - cycle) : 0;
}

bool fetches_wait(const struct memory_waits *waits, uint32_t address)
{
    if (address >= SYSTEM_BUS)
        return waits->value[MEMORY_system_fetch];
    return is_flash(waits, address) && is_flash_slow(waits);
}

int32_t waits_fetch(struct memory_waits *waits, uint32_t address, uint32_t size, int64_t cycle)
{
    if (!fetches_wait(waits, address))
        return 0;
    if (address >= SYSTEM_BUS)
        return wait_for_system_bus(waits, address, size, cycle);
    return wait_for_flash(waits, address, size, cycle, true);
}

void waits_jump(struct memory_waits *waits, int64_t cycle)
{
    waits->word = NOTHING;
    if (waits->value[MEMORY_system_fetch]) /* otherwise states before and after a turn of a waiting loop would differ */
        waits->jumped_at = cycle;
}

bool waits_are_over(const struct memory_waits *waits, uint32_t address, uint32_t size)
{
    return !fetches_wait(waits, address)
        || (is_used_last(waits, address / WORD_BYTES) && is_used_last(waits, (address + size - 1) / WORD_BYTES));
}

/* --- Data --------------------------------------------------------------------------------------------------------- */

/* Halfwords at odd addresses and words at halfwords are two parts, words at odd addresses three (TRM, 3.3.2); pairs of
 * words are two words. */
static int32_t unaligned_wait(const struct memory_waits *waits, uint32_t address, uint32_t size)
{
    uint32_t unit = size < WORD_BYTES ? size : WORD_BYTES;
    if ((address & (unit - 1)) == 0)
        return 0;
    return waits->value[MEMORY_unaligned] * (size == WORD_BYTES && address % 2 ? 2 : 1);
}

/* Mean wait of an instruction [hundredths of a cycle] because code is fetched from the bank of its data. Code
 * in flash and data in SRAM_L are both on the code bus. */
static int32_t conflict_parts(const struct memory_waits *waits, uint32_t code, uint32_t words, uint32_t data)
{
    bool is_multiple = words > 1;
    bool is_lower = data < SYSTEM_BUS;
    if (is_flash(waits, code))
        return is_lower ? waits->value[is_multiple ? MEMORY_flash_lower_multiple : MEMORY_flash_lower_single] : 0;
    if ((code < SYSTEM_BUS) != is_lower)
        return 0;
    if (is_lower)
        return waits->value[is_multiple ? MEMORY_lower_multiple : MEMORY_lower_single];
    return waits->value[is_multiple ? MEMORY_upper_multiple : MEMORY_upper_single];
}

/* Return the whole cycles of the owed parts. */
static int32_t pay_parts(struct memory_waits *waits, int32_t parts)
{
    if (parts == 0)
        return 0; /* less than a cycle is owed */
    int32_t owed = waits->parts_owed + parts;
    waits->parts_owed = owed % PARTS;
    return owed / PARTS;
}

static bool is_late(const struct memory_waits *waits, uint32_t address)
{
    for (uint32_t i = 0; i < waits->late_count; i++) {
        if (is_in_range(&waits->late[i], address))
            return true;
    }
    return false;
}

/* A late RAM delays the first access of each group; a wait that the store buffer hides delays the access behind it. */
static int32_t late_wait(struct memory_waits *waits, uint8_t role)
{
    bool waits_now = role == ACCESS_BEGINS || (role == ACCESS_BEHIND_STORE && waits->store_hidden);
    waits->store_hidden = role == ACCESS_FIRST_STORE;
    return waits_now ? waits->value[MEMORY_late_access] : 0;
}

int32_t waits_access(
    struct memory_waits *waits, uint32_t code_address, uint32_t words, bool first, uint8_t role, uint32_t address,
    uint32_t size, int64_t cycle)
{
    if (address >= BIT_BAND_ALIASES)
        return 0;
    int32_t wait = waits->has_conflicts ? unaligned_wait(waits, address, size) : 0;
    if (is_flash(waits, address)) {
        if (words <= 1 && is_flash(waits, code_address))
            wait += pay_parts(waits, waits->value[MEMORY_flash_load]);
        return is_flash_slow(waits) ? wait + wait_for_flash(waits, address, size, cycle + wait, false) : wait;
    }
    if (role != ACCESS_NONE && is_late(waits, address))
        wait += late_wait(waits, role);
    if (code_address >= SYSTEM_BUS && address >= SYSTEM_BUS)
        waits->bus_free_at = (waits->bus_free_at > cycle ? waits->bus_free_at : cycle) + 1;
    if (first && waits->has_conflicts)
        wait += pay_parts(waits, conflict_parts(waits, code_address, words, address));
    return wait;
}

int32_t waits_transfer(
    struct memory_waits *waits, uint32_t code_address, uint32_t words, uint8_t role, uint32_t address, int64_t cycle)
{
    int32_t wait = waits_access(waits, code_address, words, true, role, address, WORD_BYTES, cycle);
    if (!is_flash(waits, address) && code_address < SYSTEM_BUS && !waits->has_conflicts)
        return wait; /* only the first word may have waited */
    for (uint32_t word = 1; word < words; word++)
        wait += waits_access(
            waits, code_address, words, false, ACCESS_NONE, address + WORD_BYTES * word, WORD_BYTES, cycle + wait);
    return wait;
}
