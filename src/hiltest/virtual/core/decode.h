/* The decoder's tables of encodings.
 *
 * A row is an encoding of the ARMv7-M Architecture Reference Manual, DDI 0403E, and a group is a table of its
 * chapters A5 and A6. The first matching row of a group applies, so special cases precede the general rule.
 */
#ifndef HILTEST_DECODE_H
#define HILTEST_DECODE_H

#include "integer.h"

/* An instruction before its fields are extracted. */
struct code_word {
    uint32_t bits;    /* the halfword, or both halfwords with the first one in the upper half */
    uint32_t address;
    bool in_it_block;
};

/* A field with the number of a register. */
enum register_kind {
    REGISTER_ABSENT,
    REGISTER_LOW,    /* three bits: r0 to r7 */
    REGISTER_NOT_PC, /* four bits, UNPREDICTABLE for the PC: as the behaviour of silicon is not published, the
                        instruction is undefined, which shows the mistake at once */
    REGISTER_ANY,    /* four bits */
    REGISTER_SINGLE, /* an s register: four bits, and a separate lowest bit */
    REGISTER_FIXED,  /* no bits: the number is `low` */
};
struct register_field {
    uint8_t low, kind; /* lowest bit; enum register_kind */
};

/* A number of `width` bits from `low` on, shifted left by `shift`. */
struct number_field {
    uint8_t low, width, shift;
};

struct encoding {
    const char *name;     /* from the manual, with the number of the encoding */
    uint32_t mask, value; /* matches if bits & mask == value; encodings of two bytes are in the lower half */
    uint16_t operation;
    struct register_field d, n, m, a;
    struct number_field immediate, amount;
    /* Write the remaining fields, after all fields above; NULL if there are none. It may change the operation, since a
     * row may have several forms of one. */
    void (*extract)(const struct code_word *word, struct instruction *decoded);
    bool is_baseline;     /* ARMv6-M has this encoding of four bytes; it has all of two bytes except CBZ, CBNZ and IT */
};

struct encoding_group {
    uint32_t mask, value;
    const struct encoding *rows;
    int count;
};

/* For rows of the tables. */
#define GROUP(MASK, VALUE, ROWS) {MASK, VALUE, ROWS, (int)(sizeof(ROWS) / sizeof((ROWS)[0]))}
#define LOW(FIELD, BIT) .FIELD = {BIT, REGISTER_LOW}
#define NOT_PC(FIELD, BIT) .FIELD = {BIT, REGISTER_NOT_PC}
#define ANY(FIELD, BIT) .FIELD = {BIT, REGISTER_ANY}
#define SINGLE(FIELD, BIT) .FIELD = {BIT, REGISTER_SINGLE}
#define FIXED(FIELD, NUMBER) .FIELD = {NUMBER, REGISTER_FIXED}
#define NUMBER(BIT, WIDTH, SHIFT) .immediate = {BIT, WIDTH, SHIFT}
#define AMOUNT(BIT, WIDTH) .amount = {BIT, WIDTH, 0}

/* Lists of groups, one for each file; a group without rows ends a list. */
extern const struct encoding_group narrow_groups[], data_groups[], access_groups[], float_groups[];

/* decode_costs.c: write the fields for the cycle model, which follow from the other fields. */
void describe_costs(struct instruction *decoded);

/* Forms of a data-processing operation, as offsets from its first one, see DATA_OPERATIONS. */
enum { FORM_SETS_FLAGS = 1, FORM_REGISTER = 2, FORM_SHIFTED = 4, DATA_FORM_COUNT = 6 };
/* Forms of an access, see ACCESS_OPERATIONS. */
enum { ACCESS_IMMEDIATE, ACCESS_REGISTER, ACCESS_LITERAL, ACCESS_WRITES_BACK, ACCESS_FORM_COUNT };
enum { SP = 13, LR = 14, PC = 15 };

static inline uint32_t bits(uint32_t word, unsigned high, unsigned low)
{
    return word >> low & (0xFFFFFFFFu >> (31 - (high - low)));
}

static inline uint8_t register_at(const struct code_word *word, unsigned low)
{
    return (uint8_t)bits(word->bits, low + 3, low);
}

/* The separate bit of a single-precision register is bit 22, 7 or 5, if the others are at 12, 16 or 0. */
static inline uint8_t single_at(const struct code_word *word, unsigned low)
{
    unsigned lone = low == 12 ? 22 : low == 16 ? 7 : 5;
    return (uint8_t)(register_at(word, low) << 1 | bits(word->bits, lone, lone));
}

static inline bool is_set(uint32_t word, unsigned bit) { return word >> bit & 1; }

/* The value of the PC as an operand: the instruction's address plus 4 (A5.1.2). */
static inline uint32_t pc_operand(const struct code_word *word) { return word->address + 4; }

/* The PC as the base of a literal (Align(PC, 4)). */
static inline uint32_t literal_base(const struct code_word *word) { return pc_operand(word) & ~3u; }

static inline uint8_t count_bits(uint32_t mask)
{
    uint8_t count = 0;
    for (; mask; mask &= mask - 1) count++;
    return count;
}

static inline void undefine(struct instruction *decoded) { decoded->operation = OP_UNDEFINED; }

/* Return whether the form of a data-processing operation is one that sets the flags. */
static inline bool has_flag_form(const struct instruction *decoded)
{
    return (decoded->operation - OP_AND_I) % 2 == FORM_SETS_FLAGS;
}

/* Set the shift of a register by a number (DecodeImmShift, A7.4). */
void set_shift(struct instruction *decoded, uint32_t type, uint32_t amount);

/* Set the fields of a multiple transfer of the registers in the mask `immediate`, see OP_LDM. */
void transfer_list(struct instruction *decoded, uint8_t mode);

/* Set the cycle model's row of a hint, which has no fields. */
void hint(const struct code_word *word, struct instruction *decoded);

#endif
