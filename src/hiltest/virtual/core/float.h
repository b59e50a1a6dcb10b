/* Single-precision arithmetic of the FPU, exact to the bit: NaNs, rounding modes, flush-to-zero, exception flags.
 *
 * All values are IEEE 754 bit patterns. References are to the ARMv7-M Architecture Reference Manual, DDI 0403E, A2.5
 * and B1.4; the pseudocode's names are FPAdd, FPMul and so on.
 */
#ifndef HILTEST_FLOAT_H
#define HILTEST_FLOAT_H

#include <stdbool.h>
#include <stdint.h>

/* Bits of FPSCR. */
enum {
    FPSCR_IOC = 1 << 0, FPSCR_DZC = 1 << 1, FPSCR_OFC = 1 << 2, FPSCR_UFC = 1 << 3, FPSCR_IXC = 1 << 4,
    FPSCR_IDC = 1 << 7,
    FPSCR_ROUNDING = 3 << 22, /* 0 nearest, 1 up, 2 down, 3 towards zero */
    FPSCR_FZ = 1 << 24, FPSCR_DN = 1 << 25, FPSCR_AHP = 1 << 26,
};
#define FPSCR_FLAGS 0xF0000000u    /* N, Z, C, V */
#define FPSCR_WRITABLE 0xF7C0009Fu /* what VMSR changes */

/* Each function takes FPSCR by pointer: it reads its modes and sets its cumulative exception bits. */
uint32_t float_add(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t float_subtract(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t float_multiply(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t float_divide(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t float_square_root(uint32_t a, uint32_t *fpscr);
/* addend + a * b, rounded once (FPMulAdd). */
uint32_t float_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr);

/* Flags N, Z, C, V of a comparison in the upper four bits (FPCompare); `signals`: quiet NaNs are invalid too. */
uint32_t float_compare(uint32_t a, uint32_t b, bool signals, uint32_t *fpscr);

/* Convert to a number of `bits` bits (16 or 32) with `fraction_bits` of fraction, saturated (FPToFixed); 16-bit results
 * are extended to 32 by their sign. `truncates`: towards zero, otherwise by FPSCR. */
uint32_t float_to_fixed(
    uint32_t a, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool truncates, uint32_t *fpscr);
/* The other way; `nearest`: round to nearest whatever FPSCR says (VCVT of fixed-point numbers), otherwise by FPSCR. */
uint32_t float_from_fixed(
    uint32_t value, uint32_t bits, uint32_t fraction_bits, bool is_signed, bool nearest, uint32_t *fpscr);

/* Half precision, IEEE or alternative by FPSCR.AHP, in the low 16 bits. */
uint32_t float_to_half(uint32_t a, uint32_t *fpscr);
uint32_t float_from_half(uint32_t half, uint32_t *fpscr);

/* The same operations without the host's arithmetic, which the functions above use where it gives the same: slower, and
 * declared for the tests. */
uint32_t general_add(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_subtract(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_multiply(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_divide(uint32_t a, uint32_t b, uint32_t *fpscr);
uint32_t general_square_root(uint32_t a, uint32_t *fpscr);
uint32_t general_multiply_add(uint32_t addend, uint32_t a, uint32_t b, uint32_t *fpscr);

#endif
