@ What C cannot do: SVC with the caller's frame, and changing stacks.
    .syntax unified
    .cpu cortex-m4
    .fpu fpv4-sp-d16
    .thumb
    .text

    .global SVC_Handler
    .thumb_func
    .type SVC_Handler, %function
SVC_Handler:
    tst lr, #4
    ite eq
    mrseq r0, msp
    mrsne r0, psp
    b kernel_call
    .size SVC_Handler, . - SVC_Handler

    .global context_start
    .thumb_func
    .type context_start, %function
context_start:
    ldmia r0!, {r4-r11, lr}
    msr psp, r0
    bx lr
    .size context_start, . - context_start

    .global PendSV_Handler
    .thumb_func
    .type PendSV_Handler, %function
PendSV_Handler:
    mrs r0, psp
#ifndef WITHOUT_FLOATING_POINT_CONTEXT
    tst lr, #0x10
    it eq
    vstmdbeq r0!, {s16-s31}
#endif
    stmdb r0!, {r4-r11, lr}
    bl kernel_switch
    ldmia r0!, {r4-r11, lr}
#ifndef WITHOUT_FLOATING_POINT_CONTEXT
    tst lr, #0x10
    it eq
    vldmiaeq r0!, {s16-s31}
#endif
    msr psp, r0
    bx lr
    .size PendSV_Handler, . - PendSV_Handler
