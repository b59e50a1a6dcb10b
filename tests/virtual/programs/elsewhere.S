@ Another's code as it is, where QEMU's board has memory too: it names no address, so it may lie anywhere at a multiple
@ of 16. THEIRS is its file, OFFSET where its function begins; FIRST to THIRD are files of what the pointers lead to.
    .syntax unified
    .cpu cortex-m4
    .fpu fpv4-sp-d16

    .macro function name
    .global \name
    .thumb_func
    .type \name, %function
\name:
    .endm

    .section .vectors, "a"
    .word stack_top, start

    .text
    function start
    ldr r0, =0xE000ED88
    mov r1, #0xF00000
    str r1, [r0]            @ CPACR
    dsb
    isb
    bl run_kernel           @ one instruction between the two functions
    bl after_kernel

    function run_kernel
    push {r4, lr}
    ldr r0, =first
    ldr r1, =second
    ldr r2, =third
    ldr r3, =LENGTH
    bl theirs + OFFSET
    pop {r4, pc}

    function after_kernel
    movs r0, #0x18          @ semihosting: exit
    ldr r1, =0x20026
    bkpt 0xab
    .ltorg

    .balign 16
    .thumb_func
theirs:
    .incbin THEIRS

    .data
    .balign 16
    .global first, second, third
    .type first, %object
    .type second, %object
    .type third, %object
first:
    .incbin FIRST
    .balign 4
second:
    .incbin SECOND
    .balign 4
third:
    .incbin THIRD
