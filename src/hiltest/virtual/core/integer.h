/* Integer arithmetic of the core, as pure functions of bit patterns (DDI 0403E, D6.5, and the instructions' pages). */
#ifndef HILTEST_INTEGER_H
#define HILTEST_INTEGER_H

#include "instruction.h"

static inline uint32_t rotate_right(uint32_t value, uint32_t by)
{
    by &= 31;
    return by ? value >> by | value << (32 - by) : value;
}

static inline int32_t as_signed(uint32_t value) { return (int32_t)value; }

/* Arithmetic shift to the right by 0 to 31, which is implementation-defined in C11. */
static inline uint32_t shift_arithmetic(uint32_t value, uint32_t by)
{
    return value >> 31 ? ~(~value >> by) : value >> by;
}

/* Shift by 0 to 255 bits; *carry changes unless the number of bits is 0 (Shift_C). */
static inline uint32_t shift_value(uint32_t value, uint32_t shift, uint32_t by, uint32_t *carry)
{
    if (shift == SHIFT_RRX) {
        uint32_t result = value >> 1 | *carry << 31;
        *carry = value & 1;
        return result;
    }
    if (by == 0)
        return value;
    switch (shift) {
    case SHIFT_LSL:
        *carry = by <= 32 ? value >> (32 - by) & 1 : 0;
        return by < 32 ? value << by : 0;
    case SHIFT_LSR:
        *carry = by <= 32 ? value >> (by - 1) & 1 : 0;
        return by < 32 ? value >> by : 0;
    case SHIFT_ASR:
        if (by > 31) {
            *carry = value >> 31;
            return value >> 31 ? 0xFFFFFFFFu : 0;
        }
        *carry = value >> (by - 1) & 1;
        return shift_arithmetic(value, by);
    default:
        value = rotate_right(value, by);
        *carry = value >> 31;
        return value;
    }
}

static inline int32_t sign_extend(uint32_t value, uint32_t bits)
{
    uint32_t sign = 1u << (bits - 1);
    value &= sign | (sign - 1);
    return (int32_t)((value ^ sign) - sign);
}

/* Return half `upper` of a word, sign-extended. */
static inline int32_t signed_half(uint32_t value, uint32_t upper)
{
    return sign_extend(upper ? value >> 16 : value, 16);
}

/* Saturate to a signed range of 1 to 32 bits, or to an unsigned range of 0 to 31 bits; *saturated becomes 1 if the
 * value changes (SignedSatQ, UnsignedSatQ). */
static inline uint32_t saturate_signed(int64_t value, uint32_t bits, uint32_t *saturated)
{
    int64_t most = (INT64_C(1) << (bits - 1)) - 1, least = -most - 1;
    if (value > most || value < least) {
        *saturated = 1;
        value = value > most ? most : least;
    }
    return (uint32_t)value;
}

static inline uint32_t saturate_unsigned(int64_t value, uint32_t bits, uint32_t *saturated)
{
    int64_t most = (INT64_C(1) << bits) - 1;
    if (value > most || value < 0) {
        *saturated = 1;
        value = value > most ? most : 0;
    }
    return (uint32_t)value;
}

/* The kinds of parallel arithmetic, in the order of PARALLEL_KINDS, and its forms. */
enum parallel_kind { PARALLEL_S, PARALLEL_Q, PARALLEL_SH, PARALLEL_U, PARALLEL_UQ, PARALLEL_UH };
enum parallel_form { FORM_ADD16, FORM_ASX, FORM_SAX, FORM_SUB16, FORM_ADD8, FORM_SUB8 };

/* One lane of parallel arithmetic: reduce a sum or difference to `bits` bits; *ge is its GE flag. */
static inline uint32_t parallel_lane(int32_t sum, uint32_t bits, enum parallel_kind kind, bool adds, uint32_t *ge)
{
    uint32_t ignored = 0, mask = (1u << bits) - 1;
    switch (kind) {
    case PARALLEL_S:
        *ge = sum >= 0;
        return (uint32_t)sum & mask;
    case PARALLEL_U:
        *ge = adds ? (uint32_t)sum > mask : sum >= 0;
        return (uint32_t)sum & mask;
    case PARALLEL_Q: return saturate_signed(sum, bits, &ignored) & mask;
    case PARALLEL_UQ: return saturate_unsigned(sum, bits, &ignored) & mask;
    default: return shift_arithmetic((uint32_t)sum, 1) & mask;
    }
}

/* Parallel addition and subtraction; the kinds S and U set the four GE flags in *ge. */
static inline uint32_t parallel(uint32_t a, uint32_t b, enum parallel_kind kind, enum parallel_form form, uint32_t *ge)
{
    bool is_signed = kind < PARALLEL_U;
    uint32_t bits = form >= FORM_ADD8 ? 8 : 16, lanes = 32 / bits, result = 0, flags = 0;
    for (uint32_t lane = 0; lane < lanes; lane++) {
        bool crosses = form == FORM_ASX || form == FORM_SAX;
        bool adds = form == FORM_ADD16 || form == FORM_ADD8 || (crosses && (lane == 1) == (form == FORM_ASX));
        uint32_t mask = (1u << bits) - 1;
        uint32_t x = a >> bits * lane & mask, y = b >> bits * (crosses ? 1 - lane : lane) & mask, flag = 0;
        int32_t first = is_signed ? sign_extend(x, bits) : (int32_t)x;
        int32_t second = is_signed ? sign_extend(y, bits) : (int32_t)y;
        uint32_t value = parallel_lane(adds ? first + second : first - second, bits, kind, adds, &flag);
        result |= value << bits * lane;
        if (flag)
            flags |= (bits == 16 ? 3u : 1u) << (bits == 16 ? 2 * lane : lane);
    }
    if (kind == PARALLEL_S || kind == PARALLEL_U)
        *ge = flags;
    return result;
}

static inline uint32_t reverse_bits(uint32_t value)
{
    value = (value >> 1 & 0x55555555) | (value & 0x55555555) << 1;
    value = (value >> 2 & 0x33333333) | (value & 0x33333333) << 2;
    value = (value >> 4 & 0x0F0F0F0F) | (value & 0x0F0F0F0F) << 4;
    value = (value >> 8 & 0x00FF00FF) | (value & 0x00FF00FF) << 8;
    return value >> 16 | value << 16;
}

static inline uint32_t reverse_bytes(uint32_t value)
{
    value = (value >> 8 & 0x00FF00FF) | (value & 0x00FF00FF) << 8;
    return value >> 16 | value << 16;
}

static inline uint32_t count_leading_zeros(uint32_t value)
{
    uint32_t count = 32;
    while (value) {
        value >>= 1;
        count--;
    }
    return count;
}

static inline uint32_t absolute_differences(uint32_t a, uint32_t b)
{
    uint32_t sum = 0;
    for (uint32_t shift = 0; shift < 32; shift += 8) {
        uint32_t x = a >> shift & 0xFF, y = b >> shift & 0xFF;
        sum += x > y ? x - y : y - x;
    }
    return sum;
}

#endif
