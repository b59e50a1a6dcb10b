/**
 * @file instruction_sequences.c
 * @brief The sequences: r1 and r2 point into a buffer whose first word is its own address, r3 is 1, r4 is 0, r6 is 2^31 - 1, r7 the
 * address of the cycle counter, r8 that of a word in flash, and the flags say "equal".
 *
 * Each is run whole, and entered in its middle. Both runs have the same way in, a branch to a place that stands alike in the lines
 * of the memory, and the same end, so that their difference is what the first half adds: nothing of what a run costs at its edges.
 *
 * Behind each stands an instruction that needs the FPU, so that nothing goes on behind its end. The contents of the registers s0 to s15
 * do not matter: no instruction of this core takes longer for any of them.
 *
 * Entering an exception and returning from it can only be measured apart from within its handler. The sequences for them read the
 * cycle counter themselves: r8 is what it was before the supervisor call, r9 at the handler's first instruction, r10 at its last but
 * one, r11 behind the return. An exception leaves these registers alone. Their sum, in r0, is what is answered.
 */
#include "boards/instruction_sequences.h"

#include "boards/cycle_counter.h"
#include "calibration/fast_code.h"
#include "registers.h"

#define TIMES(count, instructions) "\t.rept " #count "\n\t" instructions "\n\t.endr\n"

/* Name and half of the body: a multiple of 16 bytes, a line of the flash. The order is that of PROTOCOL.md, and the host's. */
#define SEQUENCES(EACH)                                                                                                           \
    EACH(data, TIMES(32, "adds r0, r0, #1"))                                                                                      \
    EACH(divide, TIMES(8, "sdiv r0, r6, r3"))                                                                                     \
    EACH(load_chain, TIMES(32, "ldr r1, [r1]"))                                                                                   \
    EACH(loads, TIMES(32, "ldr r0, [r1]"))                                                                                        \
    EACH(stores, TIMES(32, "str r0, [r2, #4]"))                                                                                   \
    EACH(stores_by_register, TIMES(32, "str r0, [r2, r4]"))                                                                       \
    EACH(load_behind_store, TIMES(16, "adds r0, r0, #1\n\tstr r0, [r2, #4]\n\tldr r0, [r1]"))                                     \
    EACH(store_behind_load, TIMES(16, "adds r0, r0, #1\n\tldr r0, [r1]\n\tstr r0, [r2, #4]"))                                     \
    EACH(load_store_pairs, TIMES(16, "ldr r0, [r1]\n\tstr r0, [r2, #4]"))                                                         \
    EACH(load_multiple, TIMES(16, "ldm r1, {r0, r5, r7-r12}"))                                                                    \
    EACH(store_multiple, TIMES(16, "stm r2, {r0, r5, r7-r12}"))                                                                   \
    EACH(branch_not_taken, TIMES(32, "bne 1f\n1:"))                                                                               \
    EACH(branch_taken, TIMES(16, "b 1f\n1:"))                                                                                     \
    EACH(call_and_return, TIMES(8, "bl 8b"))                                                                                      \
    EACH(table_branch, TIMES(8, "tbb [r2, r4]"))                                                                                  \
    EACH(if_then, TIMES(16, "it eq\n\taddeq r0, r0, #1"))                                                                         \
    EACH(barrier, TIMES(16, "dmb"))                                                                                               \
    EACH(system, TIMES(32, "nop"))                                                                                                \
    EACH(exclusive, TIMES(16, "ldrex r0, [r1]"))                                                                                  \
    EACH(fp, TIMES(32, "vadd.f32 s0, s1, s2"))                                                                                    \
    EACH(fp_chain, TIMES(32, "vadd.f32 s0, s0, s1"))                                                                              \
    EACH(accumulate, TIMES(8, "vfma.f32 s0, s4, s5\n\tvfma.f32 s1, s4, s5\n\tvfma.f32 s2, s4, s5\n\tvfma.f32 s3, s4, s5"))        \
    EACH(accumulate_chain, TIMES(32, "vfma.f32 s0, s4, s5"))                                                                      \
    EACH(accumulate_and_multiply, TIMES(16, "vfma.f32 s0, s4, s5\n\tvmul.f32 s1, s6, s7"))                                        \
    EACH(accumulate_over_integers,                                                                                                \
         TIMES(16, "vfma.f32 s0, s4, s5\n\tadds r0, r0, #1\n\tadds r0, r0, #1\n\tadds r0, r0, #1\n\tadds r0, r0, #1"))            \
    EACH(fp_divide, TIMES(4, "vdiv.f32 s0, s1, s2"))                                                                              \
    EACH(fp_divide_result, TIMES(4, "vdiv.f32 s0, s1, s2\n\tvmov r0, s0"))                                                        \
    EACH(square_root, TIMES(4, "vsqrt.f32 s0, s1"))                                                                               \
    EACH(fp_loads, TIMES(32, "vldr s0, [r1]"))                                                                                    \
    EACH(fp_stores, TIMES(32, "vstr s0, [r2]"))                                                                                   \
    EACH(fp_pairs, TIMES(16, "vmov r8, r9, s0, s1"))                                                                              \
    EACH(data_independent, TIMES(16, "adds r0, r1, #1\n\tadds r5, r1, #1"))                                                       \
    EACH(multiply, TIMES(16, "mul r0, r1, r3\n\tmla r5, r1, r3, r4"))                                                             \
    EACH(multiply_chain, TIMES(32, "mla r0, r3, r3, r0"))                                                                         \
    EACH(multiply_long, TIMES(16, "umull r0, r5, r1, r3\n\tsmull r8, r9, r1, r3"))                                                \
    EACH(multiply_long_chain, TIMES(32, "smlal r0, r5, r1, r3"))                                                                  \
    EACH(multiply_pairs,                                                                                                          \
         TIMES(8, "smlad r0, r1, r3, r4\n\tsmladx r5, r1, r3, r4\n\tsmlabb r8, r1, r3, r4\n\tsmlatt r9, r1, r3, r4"))             \
    EACH(multiply_pairs_chain, TIMES(32, "smlad r0, r3, r3, r0"))                                                                 \
    EACH(pack_halves, TIMES(8, "ssub16 r0, r1, r3\n\tpkhtb r5, r1, r3, asr #16\n\tpkhbt r8, r1, r3, lsl #16\n\tuxth r9, r1"))     \
    EACH(loads_of_halves, TIMES(32, "ldrsh r0, [r1]"))                                                                            \
    EACH(stores_of_halves, TIMES(32, "strh r0, [r2, #4]"))                                                                        \
    EACH(fp_multiply, TIMES(32, "vmul.f32 s0, s1, s2"))                                                                           \
    EACH(fp_multiply_chain, TIMES(32, "vmul.f32 s0, s0, s1"))                                                                     \
    EACH(fp_convert, TIMES(8, "vcvt.f32.s32 s0, s1\n\tvmov.f32 s2, s3\n\tvabs.f32 s4, s5\n\tvneg.f32 s6, s7"))                    \
    EACH(fp_moves, TIMES(16, "vmov s0, r3\n\tvmov r0, s1"))                                                                       \
    EACH(fp_compare, TIMES(16, "vcmpe.f32 s0, s1\n\tvmrs APSR_nzcv, fpscr"))                                                      \
    EACH(fp_load_multiple, TIMES(16, "vldmia r1, {s0-s7}"))                                                                       \
    EACH(fp_store_multiple, TIMES(16, "vstmia r2, {s0-s7}"))

/* Those that read the counter themselves. The first one, of readings alone, is compared with the others. */
#define FROM_WITHIN(between, start, end)                                                                                          \
    TIMES(8, "ldr r8, [r7]\n\t" between "\n\tldr r11, [r7]\n\tsub r11, " end ", " start "\n\tadd r0, r0, r11")
#define TIMED_FROM_WITHIN(EACH)                                                                                                   \
    EACH(readings, FROM_WITHIN("nop", "r8", "r11"))                                                                               \
    EACH(exception_entry, FROM_WITHIN("svc #0", "r8", "r9"))                                                                      \
    EACH(exception_return, FROM_WITHIN("svc #0", "r10", "r11"))

/* The code that leads to half a word, so slowly that earlier effects have ended, and the code that fills a line up from a word on. */
#define TO_WORDS "\tnop.w\n\tnop.w\n\tnop.w\n"
#define TO_HALF_A_WORD TO_WORDS "\tnop\n"

/* Those of rules of fetching and of addresses. */
#define OF_RULES(EACH)                                                                                                            \
    EACH(fp_misplaced, TO_HALF_A_WORD TIMES(48, "vadd.f32 s0, s1, s2") "\tnop\n")                                                 \
    EACH(integers_misplaced, TO_HALF_A_WORD TIMES(48, "eor.w r0, r3, r4") "\tnop\n")                                              \
    EACH(load_and_three, TIMES(4, "ldr r0, [r1]\n\t.rept 3\n\teor.w r5, r3, r4\n\t.endr\n\tnop"))                                 \
    EACH(load_and_two, TIMES(4, "ldr r0, [r1]\n\t.rept 2\n\teor.w r5, r3, r4\n\t.endr\n\tnop\n\tnop.w"))                          \
    EACH(load_compare_and_three,                                                                                                  \
         TIMES(4, "ldr.w r0, [r1]\n\tcmp r3, #1\n\t.rept 3\n\teor.w r5, r3, r4\n\t.endr\n\tnop\n" TO_WORDS))                      \
    EACH(pair_and_three, TIMES(4, "nop\n\tvmov r11, r12, s0, s1\n\tumaal r0, r5, r3, r3\n\tumaal r8, r9, r3, r3\n"                \
                                  "\tumaal r10, r7, r3, r3\n\tnop\n" TO_WORDS))                                                   \
    EACH(calls_misplaced, TO_HALF_A_WORD TIMES(16, "bl 8b") "\tnop\n")                                                            \
    EACH(loop_misplaced, "\tmovs r5, #16\n1:\tsubs.w r5, r5, #1\n\tbne 1b\n\tnop.w\n\tnop.w\n")                                   \
    EACH(computed_address, TIMES(8, "adds r5, r1, #0\n\tldr r0, [r5]"))                                                           \
    EACH(compare_if_then, TIMES(8, "cmp r4, #0\n\tit eq\n\tmoveq r0, r3"))                                                        \
    EACH(wide_compare_if_then, TIMES(8, "cmp.w r4, #0\n\tit eq\n\tmoveq r0, r3"))                                                 \
    EACH(loads_one_off, TIMES(8, "ldr.w r0, [r1, #1]\n\teor.w r5, r3, r4"))                                                       \
    EACH(loads_two_off, TIMES(8, "ldr.w r0, [r1, #2]\n\teor.w r5, r3, r4"))                                                       \
    EACH(loads_three_off, TIMES(8, "ldr.w r0, [r1, #3]\n\teor.w r5, r3, r4"))                                                     \
    EACH(loads_of_one_base, TIMES(4, "ldr r0, [r1], #4\n\tldr r5, [r1], #-4"))                                                   \
    EACH(loads_of_two_bases,                                                                                                      \
         TIMES(2, "ldr r0, [r1], #4\n\tldr r5, [r2], #4\n\tldr r0, [r1], #-4\n\tldr r5, [r2], #-4"))                            \
    EACH(loads_of_two_memories, TIMES(4, "ldr.w r0, [r1]\n\tldr.w r5, [r8]"))                                                    \
    EACH(multiple_behind_store, TIMES(4, "nop\n\tstr r0, [r2, #4]\n\tldm r1, {r0, r5}"))                                        \
    EACH(fp_computed_address, TIMES(2, "vmov s0, r1\n\tvmov r5, s0\n\tldr.w r0, [r5]\n\tnop.w"))                               \
    EACH(loads_and_three,                                                                                                         \
         TIMES(2, "ldr r0, [r1]\n\tldr r5, [r1]\n\tldr r0, [r1]\n\t.rept 3\n\teor.w r5, r3, r4\n\t.endr\n\tnop\n" TO_WORDS))   \
    EACH(two_loads_and_three, TIMES(2, "nop\n\tldr.w r0, [r1]\n\teor.w r5, r3, r4\n\tldr.w r0, [r1]\n\teor.w r5, r3, r4\n"    \
                                       "\teor.w r5, r3, r4\n\tnop\n\tnop.w\n\tnop.w"))

/* The entry sets the registers and branches into a sequence. */
__asm__("\t.pushsection .fast_code.sequences, \"ax\", %progbits\n"
        "\t.balign 16\n\t.thumb_func\n\t.global sequence_enter\n\t.type sequence_enter, %function\n"
        "sequence_enter:\n"
        "\tpush {r4-r12, lr}\n"
        "\tmov r12, r1\n\tmov r1, r0\n\tadd r2, r0, #64\n\tmov r3, #1\n\tmov r4, #0\n\tmvn r6, #0x80000000\n"
        "\tldrd r7, r8, [r1, #4]\n\tmov r0, #0\n\tcmp r4, #0\n\tbx r12\n"
        "\t.size sequence_enter, . - sequence_enter\n\t.popsection\n");

/**
 * Run a sequence from its begin or its middle. Returns what it has counted itself, where it does.
 *
 * @param buffer 128 bytes: its own address, those of the cycle counter and of a word in flash, and zeros
 * @param place address, with bit 0 set as in a pointer to a function
 */
extern uint32_t sequence_enter(uint32_t *buffer, uintptr_t place);

/* 7 is where the body begins, 9 its middle; the word before the body has the size of its half. The NOP is no load, store or
 * branch behind any body. */
#define FRAMED(name, place, section, half)                                                                                        \
    __asm__("\t.pushsection " section ", \"ax\", %progbits\n"                                                                     \
            "\t.balign 16\n\t.skip 12\n\t.word 9f - 7f\n"                                                                         \
            "\t.thumb_func\n\t.type sequence_" #name "_" #place ", %function\n"                                                  \
            "sequence_" #name "_" #place ":\n"                                                                                    \
            "7:\n" half "9:\n" half "\tvadd.f32 s8, s9, s10\n\tnop\n\tpop {r4-r12, pc}\n"                                        \
            "\t.size sequence_" #name "_" #place ", . - sequence_" #name "_" #place "\n\t.popsection\n");                         \
    extern const char sequence_##name##_##place[];

/* The target of a BL, 8: in a line of its own, which the sequences of its memory share. */
#define CALLEE(section)                                                                                                           \
    __asm__("\t.pushsection " section ", \"ax\", %progbits\n\t.balign 16\n8:\tbx lr\n\t.balign 16\n\t.popsection\n");

#define IN_SRAM(name, body) FRAMED(name, sram, ".fast_code.sequences", body)
#define IN_FLASH(name, body) FRAMED(name, flash, ".text.sequences", body)
CALLEE(".fast_code.sequences")
SEQUENCES(IN_SRAM)
CALLEE(".text.sequences")
SEQUENCES(IN_FLASH)
TIMED_FROM_WITHIN(IN_SRAM)
TIMED_FROM_WITHIN(IN_FLASH)
CALLEE(".fast_code.sequences")
OF_RULES(IN_SRAM)
CALLEE(".text.sequences")
OF_RULES(IN_FLASH)

#define BOTH(name, body) {{sequence_##name##_sram, sequence_##name##_flash}, false},
#define BOTH_FROM_WITHIN(name, body) {{sequence_##name##_sram, sequence_##name##_flash}, true},
typedef struct {
    const char *in[2]; /* SRAM, flash */
    bool from_within;  /* it counts its clocks itself */
} timed_sequence_t;
static const timed_sequence_t sequences[] = {SEQUENCES(BOTH) TIMED_FROM_WITHIN(BOTH_FROM_WITHIN) OF_RULES(BOTH)};

#define NUMBER(name, body) NUMBER_##name,
enum { SEQUENCES(NUMBER) TIMED_FROM_WITHIN(NUMBER) OF_RULES(NUMBER) COUNT };

static uint32_t buffer[32];

/* Whether a supervisor call is one of these sequences'. */
__attribute__((used)) static volatile uint32_t exceptions_are_timed;

/* Any other supervisor call is as unexpected as every other exception that is not enabled. */
__asm__("\t.pushsection .fast_code.sequences, \"ax\", %progbits\n"
        "\t.balign 8\n\t.thumb_func\n\t.global SVC_Handler\n\t.type SVC_Handler, %function\n"
        "SVC_Handler:\n"
        "\tldr r9, [r7]\n"
        "\tldr r5, =exceptions_are_timed\n\tldr r5, [r5]\n\tcbz r5, 1f\n"
        "\tldr r10, [r7]\n\tbx lr\n"
        "1:\tldr pc, =Fault_Handler\n"
        "\t.ltorg\n"
        "\t.size SVC_Handler, . - SVC_Handler\n\t.popsection\n");

uint8_t sequence_count(void)
{
    return (uint8_t)COUNT;
}

/* Not by PRIMASK: a supervisor call is an interrupt, too, and under it a fault. SysTick runs only while a wait needs it. */
FAST_CODE static void interrupts_disable(uint32_t enabled[NVIC_WORDS])
{
    for (uint32_t word = 0u; word < NVIC_WORDS; word++) {
        enabled[word] = NVIC_ISER(word);
        NVIC_ICER(word) = enabled[word];
    }
    __asm volatile("dsb\n\tisb" ::: "memory"); /* none comes from here on */
}

FAST_CODE static void interrupts_enable(const uint32_t enabled[NVIC_WORDS])
{
    for (uint32_t word = 0u; word < NVIC_WORDS; word++) {
        NVIC_ISER(word) = enabled[word];
    }
}

/** In SRAM: the controller of the flash must not be switched by code that it is just fetching. */
FAST_CODE __attribute__((noinline)) static uint32_t count_sequence(const timed_sequence_t *timed, uintptr_t place, uint32_t off)
{
    uint32_t enabled[NVIC_WORDS];
    interrupts_disable(enabled);
    const uint32_t flash_bank_0 = FMC_PFB0CR;
    const uint32_t flash_bank_1 = FMC_PFB1CR;
    /* Lines that one run leaves in the cache must not make the next one faster, from SRAM neither: the vectors are in flash. */
    FMC_PFB0CR = (flash_bank_0 & ~off) | FMC_PFB_INVALIDATE;
    FMC_PFB1CR = flash_bank_1 & ~off; /* bank 0's invalidates both */
    exceptions_are_timed = timed->from_within;
    const uint32_t before = cycle_counter_read();
    const uint32_t itself = sequence_enter(buffer, place);
    const uint32_t after = cycle_counter_read();
    exceptions_are_timed = false;
    FMC_PFB0CR = flash_bank_0;
    FMC_PFB1CR = flash_bank_1;
    interrupts_enable(enabled);
    return timed->from_within ? itself : after - before;
}

static uint32_t prepare_and_count(uint8_t sequence, sequence_place_t place, uint32_t from_middle)
{
    static const uint32_t switched_off[SEQUENCE_PLACES] = {
        [SEQUENCE_IN_FLASH_ALONE] = FMC_PFB_BUFFER | FMC_PFB_PREFETCH | FMC_PFB_CACHE,
        [SEQUENCE_IN_FLASH_WITHOUT_CACHE] = FMC_PFB_CACHE,
        [SEQUENCE_IN_FLASH_WITHOUT_PREFETCH] = FMC_PFB_PREFETCH,
    };
    const timed_sequence_t *timed = &sequences[sequence];
    const uintptr_t begin = (uintptr_t)timed->in[place == SEQUENCE_IN_SRAM ? 0 : 1] & ~(uintptr_t)1u;
    const uint32_t half_bytes = *(const volatile uint32_t *)(begin - sizeof half_bytes);
    buffer[0] = (uint32_t)(uintptr_t)buffer;
    buffer[1] = (uint32_t)(uintptr_t)&DWT_CYCCNT;
    buffer[2] = (uint32_t)(uintptr_t)switched_off;
    buffer[16] = 0u; /* the table of TBB, to the next instruction: beside the code it would meet a fetch in the same memory */
    return count_sequence(timed, begin + from_middle * half_bytes + 1u, switched_off[place]);
}

uint32_t sequence_cycles(uint8_t sequence, sequence_place_t place)
{
    return prepare_and_count(sequence, place, 0u);
}

uint32_t sequence_cycles_from_middle(uint8_t sequence, sequence_place_t place)
{
    return prepare_and_count(sequence, place, 1u);
}
