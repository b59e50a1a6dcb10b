/* dpi_add_rows() of dpi_sums.h for a Cortex-M4 with FPU: to the last bit what dpi_rows.c does.
 *
 * 72 sums do not fit 32 registers, and in memory each costs a load and a store. Three passes of 24 keep theirs in registers: a block
 * of the diagonal, the one beside it and four of the target. A pass takes the six words of a row in one load, 47 multiplications and
 * additions, none of which uses the result of the one before, and half a turn of the loop: 55.5 cycles at zero wait states. */
#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP) /* as in dpi_rows.c */

    .syntax unified
    .thumb
    .section .fast_code, "ax", %progbits
    .balign 4 /* here and below, .w: 32-bit instructions begin at words, as place.py says */

/* Where dpi_row_t and dpi_sums_t have it [bytes] */
    .set ROW, 24
    .set BLOCK, 40
    .set BESIDE, 3 * BLOCK
    .set TARGET, 6 * BLOCK
    .set TARGET_PART, 16

row     .req r0 /* the argument, then behind the rows that were added */
bytes   .req r1 /* the argument, the number of rows; then what they take */
block   .req r2 /* the argument; the pass's block of the diagonal */
behind  .req r3 /* the last row */
other   .req r12

/* Sums: s0 to s9 of the diagonal, s10 to s19 beside it, s20 to s23 of the target. */
prod0   .req s24
prod1   .req s25
u0      .req s29
u1      .req s30
u2      .req s31

/* Add weight (1, u0, u1, u2) (1, u0, u1, u2)' to ten sums; all but u0 to u2 are spent. */
    .macro add_block weight, x, y, prod, one, sx, sy, sz, sxx, sxy, sxz, syy, syz, szz
    vmul.f32 \x, \weight, u0
    vmul.f32 \y, \weight, u1
    vadd.f32 \one, \one, \weight
    vmul.f32 \weight, \weight, u2   /* z */
    vadd.f32 \sx, \sx, \x
    vmul.f32 \prod, \x, u0
    vadd.f32 \sy, \sy, \y
    vadd.f32 \sxx, \sxx, \prod
    vmul.f32 \prod, \x, u1
    vmul.f32 \x, \x, u2
    vadd.f32 \sxy, \sxy, \prod
    vadd.f32 \sxz, \sxz, \x
    vmul.f32 \prod, \y, u1
    vmul.f32 \y, \y, u2
    vadd.f32 \syy, \syy, \prod
    vmul.f32 \prod, \weight, u2
    vadd.f32 \syz, \syz, \y
    vadd.f32 \sz, \sz, \weight
    vadd.f32 \szz, \szz, \prod
    .endm

/* Add the next row; g, next and spare are the three components of gravity, and spent. */
    .macro add_row g, next, spare
    vldmia row!, {s26-s31}
    vmul.f32 prod0, \g, u0
    vmul.f32 prod1, \g, u1
    vmul.f32 \spare, \g, u2
    vadd.f32 s20, s20, \g
    vadd.f32 s21, s21, prod0
    vadd.f32 s22, s22, prod1
    vadd.f32 s23, s23, \spare
    vmul.f32 prod0, \g, \next
    vmul.f32 prod1, \g, \g
    add_block prod0, \g, \next, \spare, s10, s11, s12, s13, s14, s15, s16, s17, s18, s19
    add_block prod1, \g, \next, \spare, s0, s1, s2, s3, s4, s5, s6, s7, s8, s9
    .endm

/* Add all rows to the sums of component i; two rows a turn, of which an odd number enters at the second. */
    .macro pass i, g, next, spare
    add.w other, block, #BESIDE
    vldmia block, {s0-s9}
    vldmia other, {s10-s19}
    add.w other, block, #TARGET + (TARGET_PART - BLOCK) * \i
    tst.w bytes, #ROW & -ROW
    vldmia other, {s20-s23}
    bne.w 2f
1:
    add_row \g, \next, \spare
2:
    add_row \g, \next, \spare
    cmp.w row, behind
    bne.w 1b
    vstmia other, {s20-s23}
    add.w other, block, #BESIDE
    vstmia block!, {s0-s9}
    vstmia other, {s10-s19}
    .endm

    .global dpi_add_rows
    .type dpi_add_rows, %function
    .thumb_func
dpi_add_rows:
    add.w bytes, bytes, bytes, lsl #1
    vpush {s16-s31}
    lsl.w bytes, bytes, #3
    add.w behind, row, bytes
    pass 0, s26, s27, s28
    sub.w row, row, bytes
    pass 1, s27, s28, s26
    sub.w row, row, bytes
    pass 2, s28, s26, s27
    vpop {s16-s31}
    bx lr
    .size dpi_add_rows, . - dpi_add_rows

#endif
