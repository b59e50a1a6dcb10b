/* gravity_reduce() of gravity_equations.h for a Cortex-M4 with FPU: to the last bit what gravity_equations.c does.
 *
 * Compiled, it was half of what the solution takes, 29 cycles for four products, since single loads take two cycles each. Here they are 14. */
#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP) /* as in gravity_equations.c */

    .syntax unified
    .thumb
    .section .fast_code, "ax", %progbits
    .balign 4 /* here and below, .w: 32-bit instructions begin at words, as place.py says */

    .set ROW, 48     /* bytes of a row */
    .set BORDER, 48  /* where gravity_column_t has it, behind 12 reciprocals [bytes] */
    .set SHARE, 100

row     .req r0 /* the first argument, then the next row */
column  .req r1
rows    .req r2 /* the argument, then behind the last row */
element .req r3 /* the argument, the column's number; then the element that is reduced */
border  .req r12

/* s12 is the element, s14 the row's border, s15 the column's times share; s0 to s11 the row, s16 to s27 the first one over the pivots. */
    .macro begin_row last
    vldmia row, {s0-\last}
    vldmia border!, {s14}
    vldr s12, [element]
    vmul.f32 s0, s0, s16
    vmul.f32 s14, s14, s15
    vmul.f32 s1, s1, s17
    vmul.f32 s2, s2, s18
    vsub.f32 s12, s12, s14
    vmul.f32 s3, s3, s19
    vadd.f32 s0, s0, s1
    .endm

    .macro end_row sum, label
    add.w row, row, #ROW
    add.w element, element, #ROW
    cmp.w row, rows
    vsub.f32 s12, s12, \sum
    vstr s12, [element, #-ROW]
    bne.w \label
    .endm

    .global gravity_reduce
    .type gravity_reduce, %function
    .thumb_func
gravity_reduce:
    add.w border, column, element, lsl #2
    vldr s15, [column, #SHARE]
    add.w border, border, #BORDER
    vldr s14, [border]
    add.w rows, rows, rows, lsl #1
    vpush {s16-s27}
    add.w rows, row, rows, lsl #4
    vmul.f32 s15, s15, s14
    vldmia row, {s0-s11}
    vldmia column, {s16-s27}
    vmul.f32 s16, s16, s0
    vmul.f32 s17, s17, s1
    vmul.f32 s18, s18, s2
    vmul.f32 s19, s19, s3
    cmp.w element, #4
    mov.w column, element
    add.w element, row, element, lsl #2
    bgt.w 2f
1:
    begin_row s3
    vadd.f32 s2, s2, s3
    vadd.f32 s0, s0, s2
    end_row s0, 1b
    vpop {s16-s27}
    bx lr
2:
    vmul.f32 s20, s20, s4
    vmul.f32 s21, s21, s5
    vmul.f32 s22, s22, s6
    vmul.f32 s23, s23, s7
    cmp.w column, #8
    bgt.w 4f
3:
    begin_row s7
    vmul.f32 s4, s4, s20
    vadd.f32 s2, s2, s3
    vmul.f32 s5, s5, s21
    vmul.f32 s6, s6, s22
    vadd.f32 s0, s0, s2
    vmul.f32 s7, s7, s23
    vadd.f32 s4, s4, s5
    vsub.f32 s12, s12, s0
    vadd.f32 s6, s6, s7
    vadd.f32 s4, s4, s6
    end_row s4, 3b
    vpop {s16-s27}
    bx lr
4:
    vmul.f32 s24, s24, s8
    vmul.f32 s25, s25, s9
    vmul.f32 s26, s26, s10
    vmul.f32 s27, s27, s11
5:
    begin_row s11
    vmul.f32 s4, s4, s20
    vadd.f32 s2, s2, s3
    vmul.f32 s5, s5, s21
    vmul.f32 s6, s6, s22
    vadd.f32 s0, s0, s2
    vmul.f32 s7, s7, s23
    vadd.f32 s4, s4, s5
    vsub.f32 s12, s12, s0
    vmul.f32 s8, s8, s24
    vadd.f32 s6, s6, s7
    vmul.f32 s9, s9, s25
    vmul.f32 s10, s10, s26
    vadd.f32 s4, s4, s6
    vmul.f32 s11, s11, s27
    vadd.f32 s8, s8, s9
    vsub.f32 s12, s12, s4
    vadd.f32 s10, s10, s11
    vadd.f32 s8, s8, s10
    end_row s8, 5b
    vpop {s16-s27}
    bx lr
    .size gravity_reduce, . - gravity_reduce

#endif
