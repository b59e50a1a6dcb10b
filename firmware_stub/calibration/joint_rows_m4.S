/* joint_make_rows() and joint_add_rows() of joint_sums.h for a Cortex-M4 with FPU: to the last bit what joint_rows.c does.
 *
 * Compiled, they took 190 and 228 cycles a pair at zero wait states, more than the budget of `joint` has: 24 constants, or 22 sums with
 * what they are made of, leave a compiler no registers, so it stores and loads them again. Here no instruction uses the result of the
 * one before. */
#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP) /* as in joint_rows.c */

    .syntax unified
    .thumb
    .section .fast_code, "ax", %progbits
    .balign 4 /* here and below, .w: 32-bit instructions begin at words, as place.py says */

/* Where joint_task_t, joint_row_t and joint_component_t have it [bytes] */
    .set X, 48
    .set DOTS, 96
    .set ROW, 48
    .set COMPONENT, 88

task    .req r0
points  .req r1
accelerations .req r2
left    .req r3
row     .req r12

/* s0 to s11 are x, s30 and s31 the sums of dot products and squares. */
    .global joint_make_rows
    .type joint_make_rows, %function
    .thumb_func
joint_make_rows:
    push.w {r4-r9, lr}
    vpush {s16-s31}
    ldr.w row, [sp, #92]
    add.w r4, task, #X
    vldmia r4!, {s0-s11}
    vldmia r4, {s30-s31}
1:
    ldrsh.w r4, [points]
    ldrsh.w r5, [points, #2]
    ldrsh.w r6, [points, #4]
    ldrsh.w r7, [accelerations]
    ldrsh.w r8, [accelerations, #2]
    ldrsh.w r9, [accelerations, #4]
    vldmia task, {s12-s23}
    vmov s24, r4
    vmov s25, r5
    vmov s26, r6
    vmov s27, r7
    vmov s28, r8
    vmov s29, r9
    add.w points, points, #6
    add.w accelerations, accelerations, #6
    vcvt.f32.s32 s27, s27
    vcvt.f32.s32 s28, s28
    vcvt.f32.s32 s29, s29
    vcvt.f32.s32 s24, s24
    vcvt.f32.s32 s25, s25
    vcvt.f32.s32 s26, s26
    /* gravity: s12, s15, s18 */
    vmul.f32 s12, s12, s27
    vmul.f32 s15, s15, s27
    vmul.f32 s18, s18, s27
    vmul.f32 s13, s13, s28
    vmul.f32 s16, s16, s28
    vmul.f32 s19, s19, s28
    vadd.f32 s12, s12, s13
    vadd.f32 s15, s15, s16
    vadd.f32 s18, s18, s19
    vmul.f32 s14, s14, s29
    vmul.f32 s17, s17, s29
    vmul.f32 s20, s20, s29
    vadd.f32 s12, s12, s14
    vadd.f32 s15, s15, s17
    vadd.f32 s18, s18, s20
    vadd.f32 s12, s12, s21
    vadd.f32 s15, s15, s22
    vadd.f32 s18, s18, s23
    /* the field: s13, s14, s16 */
    vmul.f32 s13, s1, s24
    vmul.f32 s14, s5, s24
    vmul.f32 s16, s9, s24
    vadd.f32 s13, s0, s13
    vadd.f32 s14, s4, s14
    vadd.f32 s16, s8, s16
    vmul.f32 s17, s2, s25
    vmul.f32 s19, s6, s25
    vmul.f32 s20, s10, s25
    vadd.f32 s13, s13, s17
    vadd.f32 s14, s14, s19
    vadd.f32 s16, s16, s20
    vmul.f32 s17, s3, s26
    vmul.f32 s19, s7, s26
    vmul.f32 s20, s11, s26
    vadd.f32 s13, s13, s17
    vadd.f32 s14, s14, s19
    vadd.f32 s16, s16, s20
    /* norms: the field's square less 1 in s17, the factors in s19 and s20 */
    vmul.f32 s17, s13, s13
    vmul.f32 s21, s12, s12
    vmul.f32 s19, s14, s14
    vmul.f32 s22, s15, s15
    vadd.f32 s17, s17, s19
    vadd.f32 s21, s21, s22
    vmul.f32 s20, s16, s16
    vmul.f32 s23, s18, s18
    vadd.f32 s17, s17, s20
    vadd.f32 s21, s21, s23
    vmov.f32 s22, #1.0
    vmov.f32 s23, #0.5
    vsub.f32 s17, s17, s22
    vmul.f32 s21, s23, s21
    vmov.f32 s20, #1.5
    vmov.f32 s19, #0.375
    vsub.f32 s20, s20, s21
    vmul.f32 s19, s19, s17
    vmul.f32 s27, s12, s20
    vsub.f32 s19, s23, s19
    vmul.f32 s28, s15, s20
    vmul.f32 s19, s17, s19
    vmul.f32 s29, s18, s20
    vsub.f32 s19, s22, s19
    /* unit gravity: s27 to s29; the direction of the field: s24 to s26 */
    vmul.f32 s24, s13, s19
    vmul.f32 s25, s14, s19
    vmul.f32 s26, s16, s19
    /* their dot product: s18; the norm less 1: s17, weighted: s19 */
    vmul.f32 s18, s24, s27
    vmul.f32 s12, s25, s28
    vmov.f32 s16, #0.125
    vmul.f32 s13, s26, s29
    vadd.f32 s18, s18, s12
    vmul.f32 s16, s16, s17
    vmul.f32 s12, s25, s29 /* t: s12 to s14 */
    vadd.f32 s18, s18, s13
    vsub.f32 s16, s23, s16
    vmul.f32 s21, s26, s28
    vmul.f32 s20, s18, s18
    vmul.f32 s17, s17, s16
    vadd.f32 s30, s30, s18
    vsub.f32 s19, s22, s20
    vadd.f32 s31, s31, s20
    vmul.f32 s13, s26, s27
    vmul.f32 s19, s19, s17
    vsub.f32 s12, s12, s21
    vmul.f32 s22, s24, s29
    vmul.f32 s17, s19, s17
    vmul.f32 s14, s24, s28
    vsub.f32 s13, s13, s22
    vmul.f32 s23, s25, s27
    vadd.f32 s31, s31, s17
    /* p: s15, s17, s19; h: s16, s18, s20 */
    vmul.f32 s15, s18, s24
    vsub.f32 s14, s14, s23
    vmul.f32 s16, s18, s25
    vmul.f32 s20, s18, s26
    vsub.f32 s15, s27, s15
    vsub.f32 s17, s28, s16
    vmul.f32 s16, s19, s24
    vmul.f32 s21, s19, s25
    vmul.f32 s22, s19, s26
    vsub.f32 s19, s29, s20
    vmul.f32 s23, s18, s15
    vmul.f32 s27, s18, s17
    vmul.f32 s20, s18, s19
    vadd.f32 s16, s16, s23
    vadd.f32 s18, s21, s27
    vadd.f32 s20, s22, s20
    vstmia row!, {s24-s26}
    subs.w left, left, #1
    vstmia row!, {s12-s20}
    bne.w 1b
    add.w r4, task, #DOTS
    vstmia r4, {s30-s31}
    vpop {s16-s31}
    pop.w {r4-r9, pc}
    .size joint_make_rows, . - joint_make_rows

    .unreq row
    .unreq left
row     .req r0 /* the argument, then behind the rows that were added */
bytes   .req r1 /* the argument, the number of rows; then what they take */
sums    .req r2
behind  .req r3 /* the last row */
other   .req r12

/* The sums of a component are s0 to s21, its row's u s26 to s28, and t s29 to s31. */
beside  .req s22
own     .req s23
wx      .req s24
wy      .req s25
u0      .req s26
u1      .req s27
u2      .req s28

/* Add all rows to the sums of component i; t_i is spent first. */
    .macro pass i, t, next, n, o
    vldmia sums, {s0-s21}
1:
    vldmia row, {s26-s31}
    vmul.f32 beside, \t, \next
    vmul.f32 own, \t, \t
    vmul.f32 wx, beside, u0
    vadd.f32 s5, s5, beside
    vmul.f32 wy, beside, u1
    vmul.f32 beside, beside, u2 /* weighted by both */
    vadd.f32 s6, s6, wx
    vadd.f32 s7, s7, wy
    vmul.f32 \t, wx, u0
    vmul.f32 \next, wx, u1
    vadd.f32 s8, s8, beside
    vmul.f32 wx, wx, u2
    vadd.f32 s9, s9, \t
    vadd.f32 s10, s10, \next
    vmul.f32 \t, wy, u1
    vmul.f32 wy, wy, u2
    vadd.f32 s11, s11, wx
    vmul.f32 beside, own, \n
    vadd.f32 s12, s12, \t
    vmul.f32 \next, own, \o
    vadd.f32 s13, s13, wy
    vmul.f32 wx, beside, \n
    vadd.f32 s0, s0, own
    vmul.f32 wy, beside, \o
    vadd.f32 s1, s1, beside
    vldr d11, [row, #24 + 8 * \i] /* p and h, in s22 and s23 */
    vadd.f32 s2, s2, \next
    vadd.f32 s3, s3, wx
    vmul.f32 wx, beside, u0
    vadd.f32 s4, s4, wy
    vmul.f32 wy, beside, u1
    vadd.f32 s14, s14, beside
    vmul.f32 \t, beside, u2
    vadd.f32 s15, s15, wx
    vmul.f32 u0, own, u0
    vadd.f32 s16, s16, wy
    vmul.f32 u1, own, u1
    vadd.f32 s17, s17, \t
    vmul.f32 u2, own, u2
    add.w row, row, #ROW
    vadd.f32 s18, s18, own
    cmp.w row, behind
    vadd.f32 s19, s19, u0
    vadd.f32 s20, s20, u1
    vadd.f32 s21, s21, u2
    bne.w 1b
    vstmia sums!, {s0-s21}
    .endm

    .global joint_add_rows
    .type joint_add_rows, %function
    .thumb_func
joint_add_rows:
    add.w bytes, bytes, bytes, lsl #1
    vpush {s16-s31}
    lsl.w bytes, bytes, #4
    add.w behind, row, bytes
    pass 0, s29, s30, u1, u2
    sub.w row, row, bytes
    pass 1, s30, s31, u2, u0
    sub.w row, row, bytes
    pass 2, s31, s29, u0, u1
    vpop {s16-s31}
    bx lr
    .size joint_add_rows, . - joint_add_rows

#endif
