/* Single-precision arithmetic of the FPU, exact to the bit: NaNs, rounding modes, flush-to-zero, exception flags.
 *
 * The general arithmetic uses integers. The host's floating-point unit computes the case that dominates real firmware:
 * FPSCR selects round-to-nearest without flush-to-zero, the result is neither special nor tiny, and an earlier result
 * was inexact, so that no exception flag can change (IXC is cumulative).
 *
 * All values are IEEE 754 bit patterns. References are to the ARMv7-M Architecture Reference Manual, DDI 0403E, A2.5
 * and B1.4; the pseudocode's names are FPAdd, FPMul and so on.
 */
#ifndef HILTEST_FLOAT_H
#define HILTEST_FLOAT_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

/* Bits of FPSCR. */
enum {
    FPSCR_IOC = 1 << 0, FPSCR_DZC = 1 << 1, FPSCR_OFC = 1 << 2, FPSCR_UFC = 1 << 3, FPSCR_IXC = 1 << 4,
    FPSCR_IDC = 1 << 7,
    FPSCR_ROUNDING = 3 << 22, /* 0 nearest, 1 up, 2 down, 3 towards zero */
    FPSCR_FZ = 1 << 24, FPSCR_DN = 1 << 25, FPSCR_AHP = 1 << 26,
};
#define FPSCR_FLAGS 0xF0000000u    /* N, Z, C, V */
#define FPSCR_WRITABLE 0xF7C0009Fu /* bits that VMSR changes */

/* The functions take FPSCR by pointer, to read its modes and to set its cumulative exception bits. Addition,
 * subtraction, multiplication and multiply-accumulate are at the end of this file. */
uint32_t float_divide(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t float_square_root(uint32_t a, uint32_t *fpscr);

/* Return the flags N, Z, C, V of a comparison in the upper four bits (FPCompare); `signals`: quiet NaNs are invalid,
 * too. */
uint32_t float_compare(uint32_t a, uint32_t b, bool signals, uint32_t *fpscr);

/* Convert to a fixed-point number of 16 or 32 bits with `fraction_bits` of fraction, with saturation (FPToFixed);
 * 16-bit results are sign-extended to 32. `truncates`: round towards zero, otherwise as FPSCR selects. */
uint32_t float_to_fixed(
    uint32_t a, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool truncates, uint32_t *fpscr);
/* The inverse. `nearest`: round to nearest (VCVT of fixed-point numbers), otherwise as FPSCR selects. */
uint32_t float_from_fixed(
    uint32_t value, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool nearest, uint32_t *fpscr);

/* Half precision in the low 16 bits, in the IEEE or the alternative format (FPSCR.AHP). */
uint32_t float_to_half(uint32_t a, uint32_t *fpscr);
uint32_t float_from_half(uint32_t half, uint32_t *fpscr);

/* The general arithmetic, for the cases in which the host's arithmetic differs. */
uint32_t general_add(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_subtract(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_multiply(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_divide(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_square_root(uint32_t a, uint32_t *fpscr);
uint32_t general_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr);

inline float to_float(uint32_t bits)
{
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

inline uint32_t from_float(float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

/* Return whether the host's result is the FPU's and leaves FPSCR unchanged: it is a finite number of at least 2^-64,
 * rounded to nearest, and IXC is already set. The lower limit makes results independent of a library compiled with
 * -ffast-math that lets the host flush subnormal numbers to zero. */
inline bool is_final(uint32_t result, uint32_t fpscr)
{
    const uint32_t smallest = (uint32_t)(127 - 64) << 23, infinity = 0x7F800000u;
    return sizeof(float_t) == sizeof(float) && (fpscr & (FPSCR_ROUNDING | FPSCR_FZ | FPSCR_IXC)) == FPSCR_IXC
        && (result & 0x7FFFFFFFu) - smallest < infinity - smallest;
}

inline uint32_t float_add(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const uint32_t sum = from_float(to_float(a) + to_float(b));
    return is_final(sum, *fpscr) ? sum : general_add(a, b, fpscr);
}

inline uint32_t float_subtract(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const uint32_t difference = from_float(to_float(a) - to_float(b));
    return is_final(difference, *fpscr) ? difference : general_subtract(a, b, fpscr);
}

inline uint32_t float_multiply(uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const uint32_t product = from_float(to_float(a) * to_float(b));
    return is_final(product, *fpscr) ? product : general_multiply(a, b, fpscr);
}

/* addend + a * b, rounded once (FPMulAdd). The product of two floats is exact in double precision; the sum is rounded
 * to double and then to float. The two roundings differ from a single one only if the double is halfway between two
 * floats. If the product of two nonzero factors is zero, the host may have flushed a subnormal one, see `is_final`. */
inline uint32_t float_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr)
{
    const double product = (double)to_float(a) * (double)to_float(b), exact_sum = product + (double)to_float(addend);
    const uint32_t sum = from_float((float)exact_sum);
    uint64_t bits;
    memcpy(&bits, &exact_sum, sizeof bits);
    const bool is_halfway = (bits & 0x1FFFFFFF) == 0x10000000;
    if (is_final(sum, *fpscr) && !is_halfway && (product != 0 || a << 1 == 0 || b << 1 == 0))
        return sum;
    return general_multiply_add(addend, a, b, fpscr);
}

#endif
