/* Single-precision arithmetic of the FPU with integers, for all modes and special values, see float.h. */
#include "float.h"

/* External definitions of the inline functions of float.h. */
extern inline float to_float(uint32_t bits);
extern inline uint32_t from_float(float number);
extern inline bool is_final(uint32_t result, uint32_t fpscr);
extern inline uint32_t float_add(uint32_t a, uint32_t b, uint32_t *fpscr);
extern inline uint32_t float_subtract(uint32_t a, uint32_t b, uint32_t *fpscr);
extern inline uint32_t float_multiply(uint32_t a, uint32_t b, uint32_t *fpscr);
extern inline uint32_t float_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr);

enum {
    TOP_BIT = 62,
    FRACTION_BITS = 23, EXPONENT_BIAS = 127, SPECIAL_EXPONENT = 0xFF,
    MANTISSA_SHIFT = TOP_BIT - FRACTION_BITS, /* from a mantissa of 24 bits to one whose top bit is TOP_BIT */
    HALF_FRACTION_BITS = 10, HALF_SPECIAL_EXPONENT = 0x1F,
    HALF_MAGNITUDE = 0x7FFF, HALF_INFINITY = 0x7C00, HALF_DEFAULT_NAN = 0x7E00, HALF_QUIET_BIT = 0x200,
    NEAREST = 0, UPWARD = 1, DOWNWARD = 2, TOWARDS_ZERO = 3,
};

static const uint32_t sign_bit = 0x80000000u, infinity_bits = 0x7F800000u, default_nan = 0x7FC00000u;
static const uint32_t fraction_mask = 0x007FFFFFu, quiet_bit = 0x00400000u;

/* In the order of precedence if an operand is a NaN. */
enum kind { KIND_NUMBER, KIND_ZERO, KIND_INFINITY, KIND_QUIET, KIND_SIGNALING };

/* An operand or an intermediate result. A number is mantissa * 2^(exponent - TOP_BIT), and TOP_BIT is the leading one
 * of the mantissa. */
struct value {
    enum kind kind;
    bool negative;
    int32_t exponent;
    uint64_t mantissa;
    uint32_t bits; /* of an operand, because a NaN is passed on unchanged */
};

struct format {
    int32_t fraction_bits, minimum_exponent;
    uint32_t special_exponent; /* exponent field of infinities and NaNs */
};

static const struct format single_format = {FRACTION_BITS, 1 - EXPONENT_BIAS, SPECIAL_EXPONENT};
static const struct format half_format = {HALF_FRACTION_BITS, -14, HALF_SPECIAL_EXPONENT};

static uint32_t rounding_mode(uint32_t fpscr) { return (fpscr & FPSCR_ROUNDING) >> 22; }

static uint32_t sign_of(bool negative) { return negative ? sign_bit : 0; }

static uint32_t invalid(uint32_t *fpscr)
{
    *fpscr |= FPSCR_IOC;
    return default_nan;
}

static int32_t leading_zeros(uint64_t number)
{
    int32_t zeros = 0;
    for (int32_t step = 32; step > 0; step /= 2) {
        const int32_t shift = number >> (64 - step) == 0 ? step : 0;
        number <<= shift;
        zeros += shift;
    }
    return zeros;
}

/* Shift to the right; the lowest bit of the result is also set if a one was shifted out. */
static uint64_t shift_with_sticky_bit(uint64_t number, int32_t distance)
{
    if (distance == 0)
        return number;
    if (distance >= 64)
        return number != 0;
    return number >> distance | (number << (64 - distance) != 0);
}

/* A number split into an integer and a fraction of 64 bits. */
struct split {
    uint64_t integer, fraction;
};

/* Split number / 2^distance. A fraction that is too long is replaced by a tiny one: rounding depends only on whether
 * the fraction is zero, less than a half, a half, or more. */
static struct split split_at(uint64_t number, int32_t distance)
{
    if (distance <= 0)
        return (struct split){number, 0};
    if (distance < 64)
        return (struct split){number >> distance, number << (64 - distance)};
    return (struct split){0, distance == 64 ? number : number != 0};
}

/* Return whether a magnitude rounds away from zero. */
static bool rounds_up(struct split magnitude, bool negative, uint32_t mode)
{
    const uint64_t half = (uint64_t)1 << 63;
    switch (mode) {
    case NEAREST: return magnitude.fraction > half || (magnitude.fraction == half && (magnitude.integer & 1) != 0);
    case UPWARD: return magnitude.fraction != 0 && !negative;
    case DOWNWARD: return magnitude.fraction != 0 && negative;
    default: return false;
    }
}

/* Result of an overflow (FPRound, its last part). */
static uint32_t overflow(bool negative, const struct format *format, uint32_t *fpscr)
{
    const uint32_t infinity = format->special_exponent << format->fraction_bits;
    const uint32_t mode = rounding_mode(*fpscr);
    const bool to_infinity = mode == NEAREST || mode == (negative ? DOWNWARD : UPWARD);
    *fpscr |= FPSCR_OFC | FPSCR_IXC;
    return to_infinity ? infinity : infinity - 1;
}

/* Round mantissa * 2^(exponent - TOP_BIT) to a format; return the magnitude's bits (FPRound). The mantissa is not zero,
 * and its lowest bit may be sticky. */
static uint32_t round_magnitude(
    bool negative, int32_t exponent, uint64_t mantissa, const struct format *format, uint32_t *fpscr)
{
    const bool is_half = format == &half_format;
    const int32_t zeros = leading_zeros(mantissa);
    const int32_t top_exponent = exponent + (63 - TOP_BIT) - zeros;
    const int32_t below_minimum = format->minimum_exponent - top_exponent;
    const bool is_tiny = below_minimum > 0; /* before rounding */
    if (is_tiny && !is_half && (*fpscr & FPSCR_FZ) != 0) {
        *fpscr |= FPSCR_UFC;
        return 0;
    }
    const int32_t distance = 63 - format->fraction_bits + (is_tiny ? below_minimum : 0);
    const struct split magnitude = split_at(mantissa << zeros, distance);
    if (is_tiny && magnitude.fraction != 0)
        *fpscr |= FPSCR_UFC;
    /* The leading one of a normal number adds one to the exponent field, and so does a carry from rounding. */
    const uint64_t exponent_field = is_tiny ? 0 : (uint64_t)-below_minimum;
    const uint64_t packed = (exponent_field << format->fraction_bits) + magnitude.integer
        + rounds_up(magnitude, negative, rounding_mode(*fpscr));
    if (is_half && (*fpscr & FPSCR_AHP) != 0) {
        if (packed > HALF_MAGNITUDE) {
            *fpscr |= FPSCR_IOC;
            return HALF_MAGNITUDE;
        }
    } else if (packed >= (uint64_t)format->special_exponent << format->fraction_bits) {
        return overflow(negative, format, fpscr);
    }
    if (magnitude.fraction != 0)
        *fpscr |= FPSCR_IXC;
    return (uint32_t)packed;
}

/* Round to single precision. */
static uint32_t round_single(bool negative, int32_t exponent, uint64_t mantissa, uint32_t *fpscr)
{
    return sign_of(negative) | round_magnitude(negative, exponent, mantissa, &single_format, fpscr);
}

/* Split an operand (FPUnpack); flush a subnormal one to zero if FPSCR says so. */
static struct value unpack(uint32_t bits, uint32_t *fpscr)
{
    const int32_t exponent = (int32_t)(bits >> FRACTION_BITS & SPECIAL_EXPONENT);
    const uint32_t fraction = bits & fraction_mask;
    struct value value = {.kind = KIND_NUMBER, .negative = (bits & sign_bit) != 0, .bits = bits};
    if (exponent == SPECIAL_EXPONENT) {
        value.kind = fraction == 0 ? KIND_INFINITY : (fraction & quiet_bit) != 0 ? KIND_QUIET : KIND_SIGNALING;
    } else if (exponent != 0) {
        value.exponent = exponent - EXPONENT_BIAS;
        value.mantissa = (uint64_t)(fraction | 1u << FRACTION_BITS) << MANTISSA_SHIFT;
    } else if (fraction == 0) {
        value.kind = KIND_ZERO;
    } else if ((*fpscr & FPSCR_FZ) != 0) {
        value.kind = KIND_ZERO;
        *fpscr |= FPSCR_IDC;
    } else {
        const int32_t zeros = leading_zeros(fraction) - (63 - FRACTION_BITS);
        value.exponent = 1 - EXPONENT_BIAS - zeros;
        value.mantissa = (uint64_t)fraction << (MANTISSA_SHIFT + zeros);
    }
    return value;
}

static bool is_nan(struct value value) { return value.kind == KIND_QUIET || value.kind == KIND_SIGNALING; }

/* Return the result of an operation with a NaN among its operands: the first signaling one, else the first quiet one
 * (FPProcessNaNs, FPProcessNaNs3, FPProcessNaN). */
static uint32_t propagate_nan(const struct value *operands, int count, uint32_t *fpscr)
{
    const struct value *nan = &operands[0];
    for (int i = 1; i < count; i++)
        if (operands[i].kind > nan->kind)
            nan = &operands[i];
    if (nan->kind == KIND_SIGNALING)
        *fpscr |= FPSCR_IOC;
    return (*fpscr & FPSCR_DN) != 0 ? default_nan : nan->bits | quiet_bit;
}

/* Return the bits of a zero, an infinity or a number to be rounded. */
static uint32_t pack(struct value value, uint32_t *fpscr)
{
    if (value.kind == KIND_NUMBER)
        return round_single(value.negative, value.exponent, value.mantissa, fpscr);
    return sign_of(value.negative) | (value.kind == KIND_INFINITY ? infinity_bits : 0);
}

/* Return the zero that is the exact sum of numbers with different signs. */
static uint32_t zero_sum(uint32_t fpscr) { return sign_of(rounding_mode(fpscr) == DOWNWARD); }

/* Add two numbers. Many leading bits can cancel out only if the exponents differ by at most 1; then no bit is shifted
 * out, since mantissas have at most 48 bits. */
static uint32_t add_numbers(struct value a, struct value b, uint32_t *fpscr)
{
    const bool swap = a.exponent < b.exponent || (a.exponent == b.exponent && a.mantissa < b.mantissa);
    const struct value large = swap ? b : a, small = swap ? a : b;
    const uint64_t aligned = shift_with_sticky_bit(small.mantissa, large.exponent - small.exponent);
    const uint64_t sum = large.negative == small.negative ? large.mantissa + aligned : large.mantissa - aligned;
    return sum == 0 ? zero_sum(*fpscr) : round_single(large.negative, large.exponent, sum, fpscr);
}

/* Add two values that are no NaNs. */
static uint32_t add_values(struct value a, struct value b, uint32_t *fpscr)
{
    if (a.kind == KIND_NUMBER && b.kind == KIND_NUMBER)
        return add_numbers(a, b, fpscr);
    if (a.kind == KIND_INFINITY && b.kind == KIND_INFINITY && a.negative != b.negative)
        return invalid(fpscr);
    if (a.kind == KIND_ZERO && b.kind == KIND_ZERO && a.negative != b.negative)
        return zero_sum(*fpscr);
    return pack(a.kind == KIND_INFINITY || b.kind == KIND_ZERO ? a : b, fpscr);
}

/* Return whether the product of two values is infinity times zero. */
static bool is_invalid_product(struct value a, struct value b)
{
    return (a.kind == KIND_INFINITY && b.kind == KIND_ZERO) || (a.kind == KIND_ZERO && b.kind == KIND_INFINITY);
}

/* Multiply two values that are neither NaNs nor infinity and zero; the product of numbers is not rounded yet. */
static struct value multiply_values(struct value a, struct value b)
{
    struct value product = {.kind = KIND_NUMBER, .negative = a.negative != b.negative};
    if (a.kind == KIND_INFINITY || b.kind == KIND_INFINITY) {
        product.kind = KIND_INFINITY;
    } else if (a.kind == KIND_ZERO || b.kind == KIND_ZERO) {
        product.kind = KIND_ZERO;
    } else {
        const uint64_t mantissa = (a.mantissa >> MANTISSA_SHIFT) * (b.mantissa >> MANTISSA_SHIFT);
        const int32_t carry = (int32_t)(mantissa >> (2 * FRACTION_BITS + 1)); /* 1 if the product is 2 or more */
        product.exponent = a.exponent + b.exponent + carry;
        product.mantissa = mantissa << (TOP_BIT - 2 * FRACTION_BITS - carry);
    }
    return product;
}

static uint32_t add_or_subtract(uint32_t a, uint32_t b, bool subtracts, uint32_t *fpscr)
{
    struct value values[] = {unpack(a, fpscr), unpack(b, fpscr)};
    if (is_nan(values[0]) || is_nan(values[1]))
        return propagate_nan(values, 2, fpscr); /* with its own sign */
    values[1].negative = values[1].negative != subtracts;
    return add_values(values[0], values[1], fpscr);
}

uint32_t general_add(uint32_t a, uint32_t b, uint32_t *fpscr) { return add_or_subtract(a, b, false, fpscr); }

uint32_t general_subtract(uint32_t a, uint32_t b, uint32_t *fpscr) { return add_or_subtract(a, b, true, fpscr); }

uint32_t general_multiply(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const struct value values[] = {unpack(a, fpscr), unpack(b, fpscr)};
    if (is_nan(values[0]) || is_nan(values[1]))
        return propagate_nan(values, 2, fpscr);
    if (is_invalid_product(values[0], values[1]))
        return invalid(fpscr);
    return pack(multiply_values(values[0], values[1]), fpscr);
}

/* The product of infinity and zero is invalid even if the addend is a quiet NaN; only a signaling one comes first. */
uint32_t general_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const struct value values[] = {unpack(addend, fpscr), unpack(a, fpscr), unpack(b, fpscr)};
    if (is_invalid_product(values[1], values[2]) && values[0].kind != KIND_SIGNALING)
        return invalid(fpscr);
    if (is_nan(values[0]) || is_nan(values[1]) || is_nan(values[2]))
        return propagate_nan(values, 3, fpscr);
    return add_values(values[0], multiply_values(values[1], values[2]), fpscr);
}

/* Divide two numbers. The quotient has 39 or 40 bits, which suffice for rounding if the lowest one is set for a
 * remainder. */
static struct value divide_numbers(struct value a, struct value b)
{
    const uint64_t dividend = a.mantissa, divisor = b.mantissa >> MANTISSA_SHIFT;
    const uint64_t quotient = dividend / divisor | (dividend % divisor != 0);
    return (struct value){
        .kind = KIND_NUMBER,
        .negative = a.negative != b.negative,
        .exponent = a.exponent - b.exponent,
        .mantissa = quotient << FRACTION_BITS,
    };
}

uint32_t general_divide(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const struct value values[] = {unpack(a, fpscr), unpack(b, fpscr)};
    const struct value dividend = values[0], divisor = values[1];
    if (is_nan(dividend) || is_nan(divisor))
        return propagate_nan(values, 2, fpscr);
    if (dividend.kind == divisor.kind && dividend.kind != KIND_NUMBER)
        return invalid(fpscr);
    if (dividend.kind == KIND_NUMBER && divisor.kind == KIND_NUMBER)
        return pack(divide_numbers(dividend, divisor), fpscr);
    const bool is_infinite = dividend.kind == KIND_INFINITY || divisor.kind == KIND_ZERO;
    if (is_infinite && dividend.kind != KIND_INFINITY)
        *fpscr |= FPSCR_DZC;
    return sign_of(dividend.negative != divisor.negative) | (is_infinite ? infinity_bits : 0);
}

uint32_t float_divide(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const uint32_t quotient = from_float(to_float(a) / to_float(b));
    return is_final(quotient, *fpscr) ? quotient : general_divide(a, b, fpscr);
}

/* Return the integer square root, rounded down, with the lowest bit set for a remainder. The radicand is at least
 * 2^62, so the root has 32 bits, of which rounding needs 26. */
static uint64_t integer_root(uint64_t radicand)
{
    uint64_t root = 0, remainder = radicand;
    for (int32_t position = 31; position >= 0; position--) {
        const uint64_t bit = (uint64_t)1 << position;
        const uint64_t step = (2 * root + bit) << position; /* (root + bit)^2 - root^2 */
        if (step <= remainder) {
            remainder -= step;
            root += bit;
        }
    }
    return root | (remainder != 0);
}

uint32_t general_square_root(uint32_t a, uint32_t *fpscr)
{
    const struct value value = unpack(a, fpscr);
    if (is_nan(value))
        return propagate_nan(&value, 1, fpscr);
    if (value.kind == KIND_ZERO)
        return sign_of(value.negative);
    if (value.negative)
        return invalid(fpscr);
    if (value.kind == KIND_INFINITY)
        return infinity_bits;
    const int32_t odd = value.exponent & 1;
    return round_single(
        false, (value.exponent - odd) / 2, integer_root(value.mantissa << odd) << (TOP_BIT - 31), fpscr);
}

uint32_t float_square_root(uint32_t a, uint32_t *fpscr)
{
    const uint32_t root = from_float(sqrtf(to_float(a)));
    return is_final(root, *fpscr) ? root : general_square_root(a, fpscr);
}

/* Return whether a is less than b, for unequal values that are not NaNs. */
static bool is_less(struct value a, struct value b)
{
    if (a.kind == KIND_ZERO)
        return !b.negative;
    if (b.kind == KIND_ZERO || a.negative != b.negative)
        return a.negative;
    return (a.bits < b.bits) != a.negative;
}

uint32_t float_compare(uint32_t a, uint32_t b, bool signals, uint32_t *fpscr)
{
    const uint32_t less = 8u << 28, equal = 6u << 28, greater = 2u << 28, unordered = 3u << 28; /* A2.5, FPCompare */
    const struct value x = unpack(a, fpscr), y = unpack(b, fpscr);
    if (is_nan(x) || is_nan(y)) {
        if (signals || x.kind == KIND_SIGNALING || y.kind == KIND_SIGNALING)
            *fpscr |= FPSCR_IOC;
        return unordered;
    }
    if ((x.kind == KIND_ZERO && y.kind == KIND_ZERO) || a == b)
        return equal;
    return is_less(x, y) ? less : greater;
}

/* Saturate a signed magnitude to a number of bits (SatQ); return it sign-extended to 32 bits. */
static uint32_t saturate(uint64_t magnitude, bool negative, uint32_t bits, bool is_signed, bool *saturated)
{
    const uint64_t range = (uint64_t)1 << (is_signed ? bits - 1 : bits);
    const uint64_t limit = !negative ? range - 1 : is_signed ? range : 0;
    *saturated = magnitude > limit;
    const uint32_t result = (uint32_t)(*saturated ? limit : magnitude);
    return negative ? 0 - result : result;
}

uint32_t float_to_fixed(
    uint32_t a, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool truncates, uint32_t *fpscr)
{
    const uint64_t too_large = (uint64_t)1 << 63;
    const struct value value = unpack(a, fpscr);
    struct split magnitude = {0, 0};
    if (is_nan(value)) {
        *fpscr |= FPSCR_IOC;
        return 0;
    }
    if (value.kind == KIND_INFINITY)
        magnitude.integer = too_large;
    if (value.kind == KIND_NUMBER) {
        const int32_t distance = TOP_BIT - value.exponent - (int32_t)fraction_bits;
        magnitude = distance < 0 ? (struct split){too_large, 0} : split_at(value.mantissa, distance);
    }
    bool saturated;
    magnitude.integer += rounds_up(magnitude, value.negative, truncates ? TOWARDS_ZERO : rounding_mode(*fpscr));
    const uint32_t result = saturate(magnitude.integer, value.negative, bits, is_signed, &saturated);
    if (saturated)
        *fpscr |= FPSCR_IOC;
    else if (magnitude.fraction != 0)
        *fpscr |= FPSCR_IXC;
    return result;
}

uint32_t float_from_fixed(
    uint32_t value, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool nearest, uint32_t *fpscr)
{
    const uint32_t mask = bits == 32 ? 0xFFFFFFFFu : (1u << bits) - 1;
    const bool negative = is_signed && (value >> (bits - 1) & 1) != 0;
    const uint32_t magnitude = (negative ? 0 - value : value) & mask;
    if (magnitude == 0)
        return 0;
    if (fraction_bits == 0 && magnitude >> (FRACTION_BITS + 1) == 0)
        return sign_of(negative) | from_float((float)magnitude); /* exact */
    uint32_t status = nearest ? *fpscr & ~(uint32_t)FPSCR_ROUNDING : *fpscr;
    const uint32_t result = round_single(negative, TOP_BIT - (int32_t)fraction_bits, magnitude, &status);
    *fpscr |= status;
    return result;
}

/* The alternative format has neither infinities nor NaNs (FPSingleToHalf). */
uint32_t float_to_half(uint32_t a, uint32_t *fpscr)
{
    const bool alternative = (*fpscr & FPSCR_AHP) != 0;
    const struct value value = unpack(a, fpscr);
    const uint32_t sign = sign_of(value.negative) >> 16;
    if (value.kind == KIND_NUMBER)
        return sign | round_magnitude(value.negative, value.exponent, value.mantissa, &half_format, fpscr);
    if (value.kind == KIND_ZERO)
        return sign;
    if (value.kind == KIND_SIGNALING || alternative)
        *fpscr |= FPSCR_IOC;
    if (value.kind == KIND_INFINITY)
        return sign | (alternative ? HALF_MAGNITUDE : HALF_INFINITY);
    if (alternative)
        return sign;
    if ((*fpscr & FPSCR_DN) != 0)
        return HALF_DEFAULT_NAN;
    return sign | HALF_DEFAULT_NAN | (a & fraction_mask) >> (FRACTION_BITS - HALF_FRACTION_BITS);
}

/* Return the single-precision bits of an infinity or a NaN of half precision. */
static uint32_t special_from_half(uint32_t sign, uint32_t fraction, uint32_t *fpscr)
{
    if (fraction == 0)
        return sign | infinity_bits;
    if ((fraction & HALF_QUIET_BIT) == 0)
        *fpscr |= FPSCR_IOC;
    if ((*fpscr & FPSCR_DN) != 0)
        return default_nan;
    return sign | default_nan | fraction << (FRACTION_BITS - HALF_FRACTION_BITS);
}

/* Flush-to-zero does not affect half-precision numbers (FPHalfToSingle, FPUnpack). */
uint32_t float_from_half(uint32_t half, uint32_t *fpscr)
{
    const uint32_t sign = (half & 0x8000) << 16, fraction = half & ((1u << HALF_FRACTION_BITS) - 1);
    const uint32_t exponent = half >> HALF_FRACTION_BITS & HALF_SPECIAL_EXPONENT;
    if (exponent == HALF_SPECIAL_EXPONENT && (*fpscr & FPSCR_AHP) == 0)
        return special_from_half(sign, fraction, fpscr);
    if (exponent == 0 && fraction == 0)
        return sign;
    const uint32_t mantissa = exponent == 0 ? fraction : fraction | 1u << HALF_FRACTION_BITS;
    const int32_t scale = (exponent == 0 ? 1 : (int32_t)exponent) - 15 - HALF_FRACTION_BITS;
    return round_single(sign != 0, TOP_BIT + scale, mantissa, fpscr);
}
