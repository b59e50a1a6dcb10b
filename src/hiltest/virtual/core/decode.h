/* The tables of encodings that the decoder is made of.
 *
 * One row is one encoding of the ARMv7-M Architecture Reference Manual, DDI 0403E, and one group is one table of its
 * chapters A5 and A6. Inside a group the first row that matches counts, so a special case stands before the rule.
 */
#ifndef HILTEST_DECODE_H
#define HILTEST_DECODE_H

#include "instruction.h"

/* An instruction before its fields are extracted. */
struct code_word {
    uint32_t bits;    /* its halfword, or its two halfwords with the first one in the upper half */
    uint32_t address;
    bool in_it_block;
};

/* Write the fields of an encoding. The row's operation, size and condition have been written before; `extract_fields`
 * may change them, since one row may stand for several forms of an operation. */
typedef void extract_fields(const struct code_word *word, struct instruction *decoded);

/* Whether ARMv6-M has the encoding too. */
enum profile { ARMV7M, ARMV6M };

struct encoding {
    const char *name;    /* the manual's, with the number of the encoding */
    uint32_t mask, value; /* it is this encoding if bits & mask == value; of two bytes, in the lower half */
    uint16_t operation;
    extract_fields *extract;
    uint8_t profile;     /* enum profile */
    uint8_t size;        /* written by `encoding_at` alone: the tables leave it 0 */
};

struct encoding_group {
    uint32_t mask, value;
    const struct encoding *rows;
    int count;
};

#define GROUP(MASK, VALUE, ROWS) { MASK, VALUE, ROWS, (int)(sizeof(ROWS) / sizeof((ROWS)[0])) }

/* Groups end with one that has no rows; each file offers its own. */
extern const struct encoding_group narrow_groups[], data_groups[], access_groups[], float_groups[];

/* For tests: all encodings in order. */
int encoding_count(void);
struct encoding encoding_at(int index);

/* Write what the cycle model needs to know, from the fields that are written already (decode_costs.c). */
void describe_costs(struct instruction *decoded);

/* Forms of a data-processing operation, counted from its first one, see DATA_OPERATIONS. */
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

static inline bool is_set(uint32_t word, unsigned bit) { return word >> bit & 1; }

/* The PC as an operand: the instruction's address plus 4 (A5.1.2). */
static inline uint32_t pc_operand(const struct code_word *word) { return word->address + 4; }

/* The PC as the base of a literal (Align(PC, 4)). */
static inline uint32_t literal_base(const struct code_word *word) { return pc_operand(word) & ~3u; }

static inline int32_t sign_extend(uint32_t value, unsigned width)
{
    uint32_t sign = 1u << (width - 1);
    return (int32_t)(((value & (sign | (sign - 1))) ^ sign) - sign);
}

static inline uint8_t count_bits(uint32_t mask)
{
    uint8_t count = 0;
    for (; mask; mask &= mask - 1) count++;
    return count;
}

static inline void undefine(struct instruction *decoded) { decoded->operation = OP_UNDEFINED; }

/* A 32-bit instruction whose operand must not be the PC is UNPREDICTABLE with it. Nobody has published what the silicon
 * does; to take it as undefined shows the mistake at once. */
static inline void refuse_pc(struct instruction *decoded, uint8_t number)
{
    if (number == PC) undefine(decoded);
}

/* Shift of a register by a number (DecodeImmShift, A7.4). */
void set_shift(struct instruction *decoded, uint32_t type, uint32_t amount);

/* Multiple transfer of the registers of a mask, see OP_LDM. */
void set_register_list(struct instruction *decoded, uint8_t base, uint32_t mask, uint8_t mode);

/* Fields of nothing: every field stays as it was initialized. */
extract_fields no_fields;

#endif
