/* The kernel of packed_moments.h: five passes over pairs of points, all sums of a pass in registers.
 *
 * A pass is unrolled four times; pairs that are over enter the first round by a jump past the bodies it leaves out. The number in
 * the comment on a body is what it costs per pair at zero wait states; a loop adds 3 or 4 to four of them. */

    .syntax unified
    .cpu cortex-m4
    .fpu fpv4-sp-d16
    .thumb
    .section .fast_code, "ax", %progbits
    .balign 4 /* here and below, .w: 32-bit instructions begin at words, as place.py says */

/* packed_block_t */
    .set TASK_PAIRS, 4
    .set TASK_ANCHOR, 12
    .set TASK_ROUNDING, 24
    .set TASK_SCALE, 32

/* packed_pair_t */
    .set PAIR, 36
    .set X, 0
    .set Y, 4
    .set Z, 8
    .set XX, 12
    .set YY, 16
    .set ZZ, 20
    .set XY, 24
    .set XZ, 28
    .set YZ, 32

/* moments_t */
    .set XXX, 4 * 10
    .set XXXX, 4 * 20

    .set UNROLLED, 4
    .set LAST, PAIR * (UNROLLED - 1)
    .set RAW, 12 /* two points as they come */
    .set RAW_LAST, RAW * (UNROLLED - 1)

/* Registers of the FPU that passes read; the registers below hold sums */
block   .req s9  /* the argument, until sums of degree 2 are converted */
sums    .req s10 /* the argument */
first   .req s11 /* address of Z in the last pair of the first round, of which the leading ones may be left out */
behind  .req s12 /* the same of a round behind the last */
skipped .req s13 /* how many bodies the first round leaves out */
scale   .req s14 /* of degree 2 and 3 */
square  .req s15 /* of degree 4 */

.macro clear registers:vararg
    .irp register, \registers
    .ifc \register, lr
    mov lr, #0
    .else
    movs \register, #0
    .endif
    .endr
.endm

/* A loop's first round: jump past the bodies that it leaves out, and past the loads of the next if they were done. */
.macro enter skipping, size, done=0
    tbb [pc, \skipping]
    .byte 2 + (\done) / 2, 2 + (\size + \done) / 2, 2 + (2 * \size + \done) / 2, 2 + (3 * \size + \done) / 2
.endm

.macro four_times body, size
99:
    \body 0
    \body 1
    \body 2
    \body 3
    .if . - 99b != UNROLLED * \size
    .error "a body does not have the size that is jumped by"
    .endif
.endm

/* Load a word of a pair of the round; r0 is the address of the word `base` of its last pair. */
.macro get register, pair, word, base
    ldr.w \register, [r0, #PAIR * \pair + \word - \base - LAST]
.endm

/* The same of the word `base` itself; with the last pair's, go on to the next round. */
.macro get_base register, pair
    .if \pair == UNROLLED - 1
    ldr.w \register, [r0], #PAIR * UNROLLED
    .else
    ldr.w \register, [r0, #PAIR * \pair - LAST]
    .endif
.endm

/* From int16 points to words of two coordinates each, relative to the anchor; sums of degree 1. A store behind a load is free:
 * the last word, r11, is stored behind the next pair's loads. 15 */
    .set ANCHOR_LOADS, 3 * 4
    .set ANCHOR_SIZE, 15 * 4
.macro anchor_pair pair
    ldr.w r12, [r0, #RAW * \pair + 4 - RAW_LAST]
    ldr.w lr, [r0, #RAW * \pair + 8 - RAW_LAST]
    .if \pair == UNROLLED - 1
    ldr.w r10, [r0], #RAW * UNROLLED
    .else
    ldr.w r10, [r0, #RAW * \pair - RAW_LAST]
    .endif
    str.w r11, [r1, #PAIR * \pair - PAIR + Z - Y - LAST]
    ssub16 r10, r10, r3
    ssub16 r12, r12, r4
    ssub16 lr, lr, r5
    pkhbt r11, r12, lr
    pkhbt r12, r10, r12
    pkhbt lr, lr, r10
    str.w r12, [r1, #PAIR * \pair + X - Y - LAST]
    .if \pair == UNROLLED - 1
    str.w lr, [r1], #PAIR * UNROLLED
    .else
    str.w lr, [r1, #PAIR * \pair - LAST]
    .endif
    smlad r7, r12, r6, r7
    smlad r8, lr, r6, r8
    smlad r9, r11, r6, r9
.endm

/* Shift both lanes left; r1 has the shift in its lowest byte, r3 clears what came over from the lower lane. */
.macro shift_lanes word
    lsl.w \word, \word, r1
    and.w \word, \word, r3
.endm

/* r12 = the rounded products of two words; `first` and `second` name the lanes of the points, `high` is spent. */
.macro multiply one, other, first, second, high
    smla\first r12, \one, \other, r1
    smla\second \high, \one, \other, r1
    pkhtb r12, \high, r12, asr #16
.endm

/* Store a product behind the last load of a body, which may have gone on to the next round. */
.macro put register, pair, word
    .if \pair == UNROLLED - 1
    str.w \register, [r0, #\word - Z - PAIR * UNROLLED]
    .else
    str.w \register, [r0, #PAIR * \pair + \word - Z - LAST]
    .endif
.endm

/* Products of two coordinates, and sums of degree 2. The last product is stored behind the next pair's loads. 39 */
    .set MULTIPLY_LOADS, 2 * 4
    .set MULTIPLY_SIZE, 39 * 4
.macro multiply_pair pair
    get r10, \pair, X, Z
    get r11, \pair, Y, Z
    str.w r12, [r0, #PAIR * \pair - PAIR + YZ - Z - LAST]
    shift_lanes r10
    shift_lanes r11
    multiply r10, r10, bb, tt, lr
    str.w r12, [r0, #PAIR * \pair + XX - Z - LAST]
    smlad r4, r12, r2, r4
    multiply r11, r11, tt, bb, lr
    str.w r12, [r0, #PAIR * \pair + YY - Z - LAST]
    smlad r7, r12, r2, r7
    multiply r10, r11, bt, tb, lr
    get_base lr, \pair
    put r12, \pair, XY
    smlad r5, r12, r2, r5
    shift_lanes lr
    multiply r10, lr, bb, tt, r10
    put r12, \pair, XZ
    smlad r6, r12, r2, r6
    multiply lr, lr, bb, tt, r10
    put r12, \pair, ZZ
    smlad r9, r12, r2, r9
    multiply r11, lr, tb, bt, r10
    smlad r8, r12, r2, r8
.endm

/* xxxx xxxy xxxz xxyy xxyz xyyy xyyz yyyy. 13 */
    .set FOURTHS_SIZE, 12 * 4
.macro fourths_of_pair pair
    get r3, \pair, YY, XX
    get r4, \pair, XY, XX
    get r5, \pair, XZ, XX
    get_base r2, \pair
    smlad r6, r2, r2, r6
    smlad r7, r2, r4, r7
    smlad r8, r2, r5, r8
    smlad r9, r4, r4, r9
    smlad r10, r4, r5, r10
    smlad r11, r3, r4, r11
    smlad r12, r3, r5, r12
    smlad lr, r3, r3, lr
.endm

/* xxzz xyzz xzzz yyzz yzzz zzzz, xzz yzz zzz. 14 */
    .set POWERS_OF_Z_SIZE, 13 * 4
.macro powers_of_z_of_pair pair
    get r1, \pair, ZZ, Z
    get r2, \pair, XZ, Z
    get r3, \pair, YZ, Z
    get_base r4, \pair
    smlad r5, r2, r2, r5
    smlad r6, r2, r3, r6
    smlad r7, r1, r2, r7
    smlad r8, r3, r3, r8
    smlad r9, r1, r3, r9
    smlad r10, r1, r1, r10
    smlad r11, r2, r4, r11
    smlad r12, r3, r4, r12
    smlad lr, r1, r4, lr
.endm

/* xxx xxy xxz xyy xyz yyy yyz, yyyz. 16 */
    .set THIRDS_SIZE, 14 * 4
.macro thirds_of_pair pair
    get r2, \pair, XX, Z
    get r3, \pair, X, Z
    get r4, \pair, Y, Z
    get r5, \pair, YY, Z
    smlad r6, r2, r3, r6
    smladx r7, r2, r4, r7
    smlad r9, r5, r3, r9
    smladx r11, r5, r4, r11
    get r1, \pair, YZ, Z
    get_base r4, \pair
    smlad r8, r2, r4, r8
    smlad r10, r1, r3, r10
    smlad r12, r5, r4, r12
    smlad lr, r1, r5, lr
.endm

/* Sums to floats; none uses what the instruction before it computes. */
.macro converted scaling, registers:vararg
    .irp register, \registers
    vcvt.f32.s32 \register, \register
    .endr
    .irp register, \registers
    vmul.f32 \register, \register, \scaling
    .endr
.endm

/* uint32_t packed_moments_block(const packed_block_t *block, moments_t *sums) */
    .global packed_moments_block
    .type packed_moments_block, %function
packed_moments_block:
    push {r4-r11, lr}
    vmov block, r0
    vmov sums, r1
    movs.w r2, #0
    msr APSR_nzcvq, r2
    vldr scale, [r0, #TASK_SCALE]
    vmul.f32 square, scale, scale
    add r6, r0, #TASK_ANCHOR
    ldm r0, {r0, r1, r2} /* points, pairs, count */
    vmov s0, r2
    adds r3, r2, #1
    lsrs r3, r3, #1 /* pairs, one for an odd point too */
    rsbs r4, r3, #0
    and r4, r4, #UNROLLED - 1
    vmov skipped, r4
    movs.w r5, #PAIR
    add r7, r1, #Z + LAST
    mla r3, r3, r5, r7
    vmov behind, r3
    mls r4, r4, r5, r7
    vmov first, r4
    lsrs r2, r2, #1 /* whole pairs */
    rsbs r11, r2, #0
    and r11, r11, #UNROLLED - 1
    mls r1, r11, r5, r1
    adds r1, #Y + LAST
    ldm r6, {r3, r4, r5}
    movs r6, #RAW
    ldm r0, {r10, r12, lr}
    adds r0, #RAW_LAST
    mla r2, r2, r6, r0
    mls r0, r11, r6, r0
    cmp r11, #UNROLLED - 1
    it eq
    addeq r0, #RAW * UNROLLED /* as the load that is done would have */
    mov r6, #0x00010001
    movs.w r7, #0
    clear r8, r9
    enter r11, ANCHOR_SIZE, ANCHOR_LOADS + 4
anchoring:
    four_times anchor_pair, ANCHOR_SIZE
    cmp r0, r2
    bne anchoring
    str r11, [r1, #Z - Y - PAIR - LAST]
    vmov lr, s0
    lsls lr, lr, #31
    beq.w multiplication
    /* the last point of an odd number: the other of its pair is the anchor */
    ldrsh r10, [r0, #-RAW_LAST]
    ldrsh r11, [r0, #2 - RAW_LAST]
    ldrsh r12, [r0, #4 - RAW_LAST]
    subs r1, #Y + LAST
    sxth r2, r3
    sub r10, r10, r2
    sub r11, r11, r3, asr #16
    sxth r2, r4
    sub r12, r12, r2
    add r7, r7, r10
    add r8, r8, r11
    add r9, r9, r12
    uxth r10, r10
    lsl r11, r11, #16
    uxth r12, r12
    stm r1, {r10, r11, r12}
multiplication:
    vmov s1, r7
    vmov s2, r8
    vmov s3, r9
    vmov r4, block
    ldr.w r5, [r4, #TASK_PAIRS]
    ldrd r1, r3, [r4, #TASK_ROUNDING]
    ldrd r10, r11, [r5]
    mov r2, #0x00010001
    vmov r0, first
    vmov r12, skipped
    clear r4, r5, r6, r7, r8, r9
    enter r12, MULTIPLY_SIZE, MULTIPLY_LOADS + 4
multiplying:
    four_times multiply_pair, MULTIPLY_SIZE
    vmov r10, behind
    cmp.w r0, r10
    bne multiplying
    str r12, [r0, #YZ - Z - PAIR - LAST]
    vmov s4, r4
    vmov s5, r5
    vmov s6, r6
    vmov s7, r7
    vmov s8, r8
    vmov s9, r9
    .irp register, s0, s1, s2, s3
    vcvt.f32.s32 \register, \register
    .endr
    converted scale, s4, s5, s6, s7, s8, s9
    vmov r0, sums
    vstm r0, {s0-s9}

    vmov r0, first
    vmov r1, behind
    vmov r2, skipped
    adds r0, #XX - Z
    adds r1, #XX - Z
    clear r6, r7, r8, r9, r10, r11, r12, lr
    enter r2, FOURTHS_SIZE
fourths:
    four_times fourths_of_pair, FOURTHS_SIZE
    cmp r0, r1
    bne fourths
    vmov r0, sums
    adds.w r0, #XXXX
    stm r0, {r6-r10}
    str r11, [r0, #4 * 6]
    str r12, [r0, #4 * 7]
    str lr, [r0, #4 * 10]

    vmov r0, first
    vmov r2, skipped
    movs.w r5, #0
    clear r6, r7, r8, r9, r10, r11, r12, lr
    enter r2, POWERS_OF_Z_SIZE
powers_of_z:
    four_times powers_of_z_of_pair, POWERS_OF_Z_SIZE
    vmov r1, behind
    cmp r0, r1
    bne powers_of_z
    vmov s5, r11
    vmov s8, r12
    vmov s9, lr
    vmov r0, sums
    adds r0, #XXXX
    str r5, [r0, #4 * 5]
    str r6, [r0, #4 * 8]
    str r7, [r0, #4 * 9]
    str r8, [r0, #4 * 12]
    str r9, [r0, #4 * 13]
    str r10, [r0, #4 * 14]

    vmov r0, first
    vmov r2, skipped
    clear r6, r7, r8, r9, r10, r11, r12, lr
    enter r2, THIRDS_SIZE
thirds:
    four_times thirds_of_pair, THIRDS_SIZE
    vmov r1, behind
    cmp r0, r1
    bne thirds
    vmov r0, sums
    adds.w r0, #XXX
    str lr, [r0, #XXXX - XXX + 4 * 11]
    vmov s0, r6
    vmov s1, r7
    vmov s2, r8
    vmov s3, r9
    vmov s4, r10
    vmov s6, r11
    vmov s7, r12
    converted scale, s0, s1, s2, s3, s4, s5, s6, s7, s8, s9
    vstm r0!, {s0-s9}
    add r1, r0, #4 * 15 /* of degree 4, as whole numbers still, five at a time */
converting:
    vldm r0, {s0-s4}
    converted square, s0, s1, s2, s3, s4
    vstm r0!, {s0-s4}
    cmp r0, r1
    bne converting

    mrs r0, APSR
    ubfx r0, r0, #27, #1
    pop {r4-r11, pc}
    .size packed_moments_block, . - packed_moments_block
