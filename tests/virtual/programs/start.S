@ Vectors and start-up for the test programs. A program defines main and what handlers it wants.
    .syntax unified
    .cpu cortex-m4
    .thumb
    .section .vectors, "a"
    .word stack_top
    .word start + 1
    .rept 9
    .word unhandled + 1
    .endr
    .word SVC_Handler
    .word unhandled + 1, unhandled + 1
    .word PendSV_Handler
    .word SysTick_Handler
    .rept 86
    .word unhandled + 1
    .endr

    .text
    .global start
    .thumb_func
    .type start, %function
start:
    ldr r0, =data_start
    ldr r1, =data_end
    ldr r2, =data_load
1:  cmp r0, r1
    bhs 2f
    ldr r3, [r2], #4
    str r3, [r0], #4
    b 1b
2:  bl main
3:  wfi
    b 3b
    .size start, . - start

    .thumb_func
    .type unhandled, %function
unhandled:
    bkpt 0
    .size unhandled, . - unhandled

    .weak SVC_Handler, PendSV_Handler, SysTick_Handler
    .thumb_set SVC_Handler, unhandled
    .thumb_set PendSV_Handler, unhandled
    .thumb_set SysTick_Handler, unhandled
