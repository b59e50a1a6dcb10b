/* quadric_fit() of normal_equations.h for a Cortex-M4 with FPU: to the last bit what normal_equations.c does, in 952 cycles. A compiler
 * took 296 more than this for the quadric alone.
 *
 * The FPU loads and stores N words that lie side by side in 1 + N cycles, and one by one in 2 N; a compiler does not see that. So
 * the 31 moments of degree 2 to 4 come in one load. Columns 0 to 2 of all ten rows are reduced where they were loaded; of what they
 * leave, columns 3 and 4 wait on the stack and columns 5 to 8 stay in registers to the end. No instruction uses the result of the
 * one before, if another can stand between, and integer instructions hide behind divisions.
 *
 * Each register has a name. aij is the element in row i and column j: once columns before j have been taken from it, L_ij d_j. lij is
 * L_ij, recipj is 1/d_j, yj is -L_9j, where the solution starts from, xj the solution, and wj what solution_t names weakest. */
#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP) /* as in normal_equations.c */

    .syntax unified
    .thumb
    .section .fast_code, "ax", %progbits
    .balign 4 /* here and below, .w: 32-bit instructions begin at words, as place.py says */

/* Where moments_t has them [bytes] */
    .set ONE, 0
    .set X, 4
    .set Y, 8
    .set Z, 12
    .set XX, 16
    .set XY, 20
    .set XZ, 24
    .set YY, 28
    .set YZ, 32
    .set ZZ, 36
    .set XXZ, 48
    .set XYZ, 56
    .set XZZ, 60
    .set YYZ, 68
    .set YZZ, 72
    .set ZZZ, 76
    .set XXYY, 92
    .set XXZZ, 100
    .set XYZZ, 112
    .set XZZZ, 116
    .set YYZZ, 128
    .set YZZZ, 132

/* The stack: three elements of L a row, columns 3 and 4 between them, then y0 to y2 [bytes from sp] */
    .set L_ROWS_1_TO_3, 0
    .set COLUMN_3, 24
    .set L_ROW_4, 52
    .set COLUMN_4, 64
    .set L_ROWS_5_TO_8, 88
    .set FRAME, 148

/* Where solution_t has w0 to w7 and 1/d0 to 1/d8, behind the quadric [bytes] */
    .set W3, 52
    .set W4, 56
    .set W5, 60
    .set W6, 64
    .set W7, 68
    .set RECIP0, 72
    .set RECIP1, 76
    .set RECIP2, 80
    .set RECIP3, 84
    .set RECIP4, 88
    .set RECIP5, 92
    .set RECIP6, 96
    .set RECIP7, 100
    .set RECIP8, 104

/* r0 are the sums, r1 the solution. */
worst   .req r2     /* ratio so far, as bits: positive floats are in the order of unsigned numbers, all else is larger */
latest  .req r3     /* ratio, not compared yet */
element .req r12    /* of the diagonal, before anything was taken from it */
waiting .req r12    /* where the next goes that waits */

/* a -= a1 a2 and b -= b1 b2 */
    .macro less_2 a, a1, a2, b, b1, b2
    vmul.f32 prod0, \a1, \a2
    vmul.f32 prod1, \b1, \b2
    vsub.f32 \a, \a, prod0
    vsub.f32 \b, \b, prod1
    .endm

/* Take columns 0 to 2 from two elements, in rows i and k. */
    .macro less_columns_2 a, i, b, k
    less_2 \a, a\i\()0, l0, \b, a\k\()0, l0
    less_2 \a, a\i\()1, l1, \b, a\k\()1, l1
    less_2 \a, a\i\()2, l2, \b, a\k\()2, l2
    .endm

/* Take columns 0 to 2 from one element, in row i. */
    .macro less_columns a, i
    vmul.f32 prod0, a\i\()0, l0
    vmul.f32 prod1, a\i\()1, l1
    vsub.f32 \a, \a, prod0
    vmul.f32 prod0, a\i\()2, l2
    vsub.f32 \a, \a, prod1
    vsub.f32 \a, \a, prod0
    .endm

/* Row i of L, columns 0 to 2 */
    .macro l_of i
    vmul.f32 l0, a\i\()0, recip0
    vmul.f32 l1, a\i\()1, recip1
    vmul.f32 l2, a\i\()2, recip2
    .endm

/* Keep the larger ratio. */
    .macro compare_ratios
    cmp latest, worst
    it hi
    movhi.w worst, latest
    .endm

/* Begin 1 / pivot; while it lasts, compare the ratio of the pivot before, and fetch what this one was before reduction. */
    .macro divide recip, pivot, moment
    vdiv.f32 \recip, one, \pivot
    compare_ratios
    ldr element, [r0, #\moment]
    vmov prod0, element
    .endm

    .global quadric_fit
    .type quadric_fit, %function
    .thumb_func
quadric_fit:
    vpush {s16-s31}
    add r3, r0, #XX
    sub.w sp, #FRAME
    vldmia r3, {s0-s30}
one     .req s31
    vmov.f32 one, #1.0

/* Columns 0 to 2: what no moment is by itself is formed in the place of one that it is formed of. */
a52     .req s7
a62     .req s9
a72     .req s10
a82     .req s1
a22     .req s19
a32     .req s20
a42     .req s23
a92     .req s24
a70     .req s8
    vsub.f32 a70, s8, s15       /* xxz - zzz */
a71     .req s13
    vsub.f32 a71, s13, s15      /* yyz - zzz */
a50     .req s6
    vsub.f32 a50, s6, s11       /* xxx - xzz */
a51     .req s11
    vsub.f32 a51, s9, s11       /* xyy - xzz */
a61     .req s12
    vsub.f32 a61, s12, s14      /* yyy - yzz */
a60     .req s14
    vsub.f32 a60, s7, s14       /* xxy - yzz */
a80     .req s15
    vsub.f32 a80, s0, s5        /* xx - zz */
a81     .req s5
    vsub.f32 a81, s3, s5        /* yy - zz */
a00     .req s16
    vsub.f32 a00, s16, s21      /* xxxx - xxzz */
a11     .req s26
    vsub.f32 a11, s26, s28      /* yyyy - yyzz */
    vsub.f32 s0, s19, s28       /* xxyy - yyzz */
a90     .req s21
    vsub.f32 a90, s21, s30      /* xxzz - zzzz */
a91     .req s28
    vsub.f32 a91, s28, s30      /* yyzz - zzzz */
a20     .req s17
    vsub.f32 a20, s17, s24      /* xxxy - xyzz */
a21     .req s22
    vsub.f32 a21, s22, s24      /* xyyy - xyzz */
    vsub.f32 a00, a00, a90
    vsub.f32 a11, a11, a91
a10     .req s30
    vsub.f32 a10, s0, a90
a30     .req s18
    vsub.f32 a30, s18, s25      /* xxxz - xzzz */
a31     .req s25
    vsub.f32 a31, s23, s25      /* xyyz - xzzz */
a41     .req s27
    vsub.f32 a41, s27, s29      /* yyyz - yzzz */
a40     .req s29
    vsub.f32 a40, s20, s29      /* xxyz - yzzz */

/* Column 0 */
prod0      .req s3
prod1      .req s4
recip0  .req s16
    vdiv.f32 recip0, one, a00
    mov worst, #0x3f800000      /* 1.0, the ratio of pivot 0 */
l10     .req s2
    vmul.f32 l10, a10, recip0
    vmov.f32 s0, a11
    less_2 a11, a10, l10, a21, a20, l10
    less_2 a31, a30, l10, a41, a40, l10
    less_2 a51, a50, l10, a61, a60, l10
    less_2 a71, a70, l10, a81, a80, l10
    vmul.f32 prod0, a90, l10
l20     .req s30                /* a10 is done with */
    vmul.f32 l20, a20, recip0
    vsub.f32 a91, a91, prod0

/* Column 1 */
recip1  .req s26
    vdiv.f32 recip1, one, a11
    vmul.f32 s0, s0, recip1
    less_2 a22, a20, l20, a32, a30, l20
    vmov latest, s0
l21     .req s0
    vmul.f32 l21, a21, recip1
    less_2 a42, a40, l20, a52, a50, l20
    less_2 a62, a60, l20, a72, a70, l20
    less_2 a82, a80, l20, a92, a90, l20
    less_2 a22, a21, l21, a32, a31, l21
    less_2 a42, a41, l21, a52, a51, l21
    less_2 a62, a61, l21, a72, a71, l21
    less_2 a82, a81, l21, a92, a91, l21

/* Column 2 */
recip2  .req s19
    divide recip2, a22, XXYY
    vstr l10, [sp, #L_ROWS_1_TO_3]
    vmul.f32 prod0, prod0, recip2
    vstr l20, [sp, #L_ROWS_1_TO_3 + 4]
    vmov latest, prod0
    vstr l21, [sp, #L_ROWS_1_TO_3 + 8]
    add waiting, sp, #L_ROWS_1_TO_3 + 12
    .unreq prod0
    .unreq prod1

/* Columns 0 to 2 are taken from columns 3 and 4, which wait. */
l0      .req s2
l1      .req s3
l2      .req s4
prod0      .req s0
prod1      .req s17
    l_of 3
    vldr s30, [r0, #XXZZ]
    vldr s31, [r0, #XYZZ]
    vstmia waiting!, {l0-l2}
    less_columns_2 s30, 3, s31, 4
    vstmia waiting!, {s30-s31}
    vldr s30, [r0, #XXZ]
    vldr s31, [r0, #XYZ]
    less_columns_2 s30, 5, s31, 6
    vstmia waiting!, {s30-s31}
    vldr s30, [r0, #XZZ]
    vldr s31, [r0, #XZ]
    less_columns_2 s30, 7, s31, 8
    vstmia waiting!, {s30-s31}
    vldr s30, [r0, #XZZZ]
    less_columns s30, 9
    l_of 4
    vstmia waiting!, {s30}
    vstmia waiting!, {l0-l2}
    vldr s30, [r0, #YYZZ]
    vldr s31, [r0, #XYZ]
    less_columns_2 s30, 4, s31, 5
    vstmia waiting!, {s30-s31}
    vldr s30, [r0, #YYZ]
    vldr s31, [r0, #YZZ]
    less_columns_2 s30, 6, s31, 7
    vstmia waiting!, {s30-s31}
    vldr s30, [r0, #YZ]
    vldr s31, [r0, #YZZZ]
    less_columns_2 s30, 8, s31, 9
    l_of 5
    vstmia waiting!, {s30-s31}

/* and from columns 5 to 8, which stay, in registers of rows that are done with. */
a55     .req s18
a65     .req s20
a75     .req s22
a85     .req s23
a95     .req s25
    vldr a55, [r0, #XX]
    vldr a65, [r0, #XY]
    vldr a75, [r0, #XZ]
    vldr a85, [r0, #X]
    vldr a95, [r0, #XZZ]
    vstmia waiting!, {l0-l2}
    less_columns_2 a55, 5, a65, 6
    less_columns_2 a75, 7, a85, 8
    less_columns a95, 9
    l_of 6
a66     .req s27
a76     .req s29
a86     .req s30
a96     .req s31
    .unreq one
    vldr a66, [r0, #YY]
    vldr a76, [r0, #YZ]
    vldr a86, [r0, #Y]
    vldr a96, [r0, #YZZ]
    vstmia waiting!, {l0-l2}
    less_columns_2 a66, 6, a76, 7
    less_columns_2 a86, 8, a96, 9
    l_of 7
a77     .req s14
a87     .req s12
a97     .req s11
    vldr a77, [r0, #ZZ]
    vldr a87, [r0, #Z]
    vldr a97, [r0, #ZZZ]
    vstmia waiting!, {l0-l2}
    less_columns_2 a77, 7, a87, 8
    less_columns a97, 9
    l_of 8
a88     .req s13
a98     .req s10
    vldr a88, [r0, #ONE]
    vldr a98, [r0, #ZZ]
    vstmia waiting!, {l0-l2}
    less_columns_2 a88, 8, a98, 9
    vnmul.f32 l0, a90, recip0
    vnmul.f32 l1, a91, recip1
    vnmul.f32 l2, a92, recip2
    vstr recip0, [r1, #RECIP0]
    vstr recip1, [r1, #RECIP1]
    vstr recip2, [r1, #RECIP2]
one     .req s21
    vmov.f32 one, #1.0
    vstmia waiting!, {l0-l2}

/* Column 3 */
    add waiting, sp, #COLUMN_3
    vldmia waiting!, {s0-s6}
    add waiting, #COLUMN_4 - L_ROW_4
    vldmia waiting!, {s7-s9}
    vldmia waiting, {s15-s17}
    .unreq prod0
    .unreq prod1
prod0      .req s19
prod1      .req s28
a43     .req s1
a53     .req s2
a63     .req s3
a73     .req s4
a83     .req s5
a93     .req s6
a44     .req s7
a54     .req s8
a64     .req s9
a74     .req s15
a84     .req s16
a94     .req s17
recip3  .req s0
    divide recip3, s0, XXZZ
l43     .req s24
    vmul.f32 l43, a43, recip3
    vmul.f32 prod0, prod0, recip3
    vmul.f32 prod1, a43, l43
    vmov latest, prod0
    vsub.f32 a44, a44, prod1
    less_2 a54, a53, l43, a64, a63, l43
    less_2 a74, a73, l43, a84, a83, l43
    vmul.f32 prod0, a93, l43
l53     .req s26
    vmul.f32 l53, a53, recip3
    vsub.f32 a94, a94, prod0

/* Column 4; then both are taken from columns 5 to 8. */
recip4  .req s7
    divide recip4, a44, YYZZ
l54     .req s21
    .unreq one
    vmul.f32 l54, a54, recip4
    vmul.f32 prod0, prod0, recip4
    vmul.f32 prod1, a53, l53
    vmov latest, prod0
    vsub.f32 a55, a55, prod1
    less_2 a65, a63, l53, a75, a73, l53
    less_2 a85, a83, l53, a95, a93, l53
    less_2 a55, a54, l54, a65, a64, l54
    less_2 a75, a74, l54, a85, a84, l54
    vmul.f32 prod0, a94, l54
l63     .req s2
    vmul.f32 l63, a63, recip3
    vsub.f32 a95, a95, prod0
l64     .req s8
    vmul.f32 l64, a64, recip4
    less_2 a66, a63, l63, a76, a73, l63
    less_2 a86, a83, l63, a96, a93, l63
    less_2 a66, a64, l64, a76, a74, l64
    less_2 a86, a84, l64, a96, a94, l64
l73     .req s3
    vmul.f32 l73, a73, recip3
l74     .req s9
    vmul.f32 l74, a74, recip4
    less_2 a77, a73, l73, a87, a83, l73
    less_2 a97, a93, l73, a77, a74, l74
    less_2 a87, a84, l74, a97, a94, l74
l83     .req s4
    vmul.f32 l83, a83, recip3
l84     .req s15
    vmul.f32 l84, a84, recip4
    less_2 a88, a83, l83, a98, a93, l83
    less_2 a88, a84, l84, a98, a94, l84
y3      .req s16
    vnmul.f32 y3, a93, recip3
    vstr recip3, [r1, #RECIP3]
y4      .req s17
    vnmul.f32 y4, a94, recip4
    vstr recip4, [r1, #RECIP4]
one     .req s5
    vmov.f32 one, #1.0

/* Column 5 */
recip5  .req s18
    divide recip5, a55, XX
l65     .req s0
    vmul.f32 l65, a65, recip5
    vmul.f32 prod0, prod0, recip5
l75     .req s1
    vmul.f32 l75, a75, recip5
    vmov latest, prod0
l85     .req s6
    vmul.f32 l85, a85, recip5
y5      .req s7
    vnmul.f32 y5, a95, recip5
    vstr recip5, [r1, #RECIP5]
    less_2 a66, a65, l65, a76, a75, l65
    less_2 a86, a85, l65, a96, a95, l65
    less_2 a77, a75, l75, a87, a85, l75
    vmul.f32 prod0, a95, l75
    vmul.f32 prod1, a85, l85
    vsub.f32 a97, a97, prod0
    vmul.f32 prod0, a95, l85
    vsub.f32 a88, a88, prod1
    vsub.f32 a98, a98, prod0

/* Column 6 */
recip6  .req s27
    divide recip6, a66, YY
l76     .req s20
    vmul.f32 l76, a76, recip6
    vmul.f32 prod0, prod0, recip6
l86     .req s22
    vmul.f32 l86, a86, recip6
    vmov latest, prod0
y6      .req s23
    vnmul.f32 y6, a96, recip6
    vstr recip6, [r1, #RECIP6]
    less_2 a77, a76, l76, a87, a86, l76
    vmul.f32 prod0, a96, l76
    vmul.f32 prod1, a86, l86
    vsub.f32 a97, a97, prod0
    vmul.f32 prod0, a96, l86
    vsub.f32 a88, a88, prod1
    vsub.f32 a98, a98, prod0

/* Column 7 */
recip7  .req s14
    divide recip7, a77, ZZ
l87     .req s25
    vmul.f32 l87, a87, recip7
    vmul.f32 prod0, prod0, recip7
y7      .req s18
    vnmul.f32 y7, a97, recip7
    vstr recip7, [r1, #RECIP7]
    vmov latest, prod0
    less_2 a88, a87, l87, a98, a97, l87

/* Column 8, and the solution from the last on, as far as it needs what is in registers */
recip8  .req s13
    divide recip8, a88, ONE
x8      .req s31
    vnmul.f32 x8, a98, recip8
    vstr recip8, [r1, #RECIP8]
    vmul.f32 prod0, prod0, recip8
    movw r12, #0x2400           /* COVERAGE_SINGULAR, as bits */
    movt r12, #0x4974
    vmov latest, prod0
    compare_ratios
    cmp.w worst, r12
    bhs 2f
    .unreq prod1
prod1      .req s27
x7      .req s30
x6      .req s29
x5      .req s28
x4      .req s17
x3      .req s16
    vmul.f32 prod0, l87, x8
    vmul.f32 prod1, l86, x8
    vsub.f32 x7, y7, prod0
    vsub.f32 y6, y6, prod1
    less_2 y5, l85, x8, y4, l84, x8
    vmul.f32 prod0, l83, x8
    vmul.f32 prod1, l76, x7
    vsub.f32 y3, y3, prod0
    vsub.f32 x6, y6, prod1
    less_2 y5, l75, x7, y4, l74, x7
    vmul.f32 prod0, l73, x7
    vmul.f32 prod1, l65, x6
    vsub.f32 y3, y3, prod0
    vsub.f32 x5, y5, prod1
    less_2 y4, l64, x6, y3, l63, x6
    less_2 x4, l54, x5, x3, l53, x5
    vmul.f32 prod0, l43, x4

/* w7 to w3, which begin as row 8 of L */
w7      .req s25                /* l87 */
w6      .req s22                /* l86 */
w5      .req s23
w4      .req s15                /* l84 */
w3      .req s18
    vstr w7, [r1, #W7]
    vsub.f32 x3, x3, prod0
    vmul.f32 prod0, l76, w7
    vmul.f32 prod1, l75, w7
    vsub.f32 w6, w6, prod0
    vsub.f32 w5, l85, prod1
    vmul.f32 prod0, l74, w7
    vmul.f32 prod1, l73, w7
    vsub.f32 w4, w4, prod0
    vsub.f32 w3, l83, prod1
    vmul.f32 prod0, l65, w6
    vmul.f32 prod1, l64, w6
    vsub.f32 w5, w5, prod0
    vsub.f32 w4, w4, prod1
    vmul.f32 prod0, l63, w6
    vmul.f32 prod1, l54, w5
    vsub.f32 w3, w3, prod0
    vsub.f32 w4, w4, prod1
    vmul.f32 prod0, l53, w5
    vmul.f32 prod1, l43, w4
    vsub.f32 w3, w3, prod0
    vstr w6, [r1, #W6]
    vsub.f32 w3, w3, prod1
    vstr w5, [r1, #W5]
    vstr w4, [r1, #W4]
    vstr w3, [r1, #W3]
    add waiting, sp, #L_ROWS_5_TO_8
    vldmia waiting, {s0-s14}    /* y0 to y2 behind the rows */

/* Rows 8 to 3 of L, columns 0 to 2 */
y0      .req s12
y1      .req s13
y2      .req s14
    .unreq prod1
prod1      .req s20
prod2      .req s21
w0      .req s9
w1      .req s10
w2      .req s11
    .macro less_row to, x, l_0, l_1, l_2
    vmul.f32 prod0, \l_0, \x
    vmul.f32 prod1, \l_1, \x
    vmul.f32 prod2, \l_2, \x
    vsub.f32 \to\()0, \to\()0, prod0
    vsub.f32 \to\()1, \to\()1, prod1
    vsub.f32 \to\()2, \to\()2, prod2
    .endm
    less_row y, x8, w0, w1, w2  /* which begin as this row */
    less_row y, x7, s6, s7, s8
    less_row w, w7, s6, s7, s8
    less_row y, x6, s3, s4, s5
    less_row w, w6, s3, s4, s5
    less_row y, x5, s0, s1, s2
    less_row w, w5, s0, s1, s2
    vldmia sp, {s3-s8}          /* rows 1 to 3 */
    add waiting, sp, #L_ROW_4
    vldmia waiting, {s0-s2}
    less_row y, x4, s0, s1, s2
    less_row w, w4, s0, s1, s2
    less_row y, x3, s6, s7, s8
    less_row w, w3, s6, s7, s8
    vmov.f32 s15, #0.5
    vmov.f32 s18, #1.0

/* The quadric: xx, xy, xz, yy, yz, zz of its shape, then linear and constant; and w1 and w0 */
    vmul.f32 prod0, s5, y2
    vmul.f32 prod1, s4, y2
    vmul.f32 prod2, s5, w2
    vsub.f32 s25, y1, prod0        /* yy */
    vsub.f32 y0, y0, prod1
    vsub.f32 w1, w1, prod2
    vmul.f32 prod0, s3, s25
    vmul.f32 prod1, s4, w2
    vmul.f32 prod2, s3, w1
    vsub.f32 s22, y0, prod0        /* xx */
    vsub.f32 w0, w0, prod1
    vmul.f32 s23, y2, s15       /* xy */
    vsub.f32 w0, w0, prod2
    vmul.f32 s24, x3, s15       /* xz */
    vsub.f32 s27, s18, s22      /* zz = 1 - xx - yy */
    vmul.f32 s26, x4, s15       /* yz */
    vsub.f32 s27, s27, s25
    vmov s0, worst
    vstmia r1!, {s22-s31}
    vstmia r1, {w0-w2}
1:
    add sp, #FRAME
    vpop {s16-s31}
    bx lr
2:
    vmov s0, r12
    b 1b
    .size quadric_fit, . - quadric_fit

#endif
