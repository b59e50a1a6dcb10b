@ Vectors and start-up for the test programs. A program defines main and what handlers it wants.
    .syntax unified
    .cpu cortex-m4
    .thumb
    .altmacro

    .macro vector name
    .weak \name
    .thumb_set \name, unhandled
    .word \name
    .endm

    .macro interrupt number
    vector Interrupt\number\()_Handler
    .endm

    .section .vectors, "a"
    .word stack_top
    .word start + 1
    vector NMI_Handler
    vector HardFault_Handler
    vector MemManage_Handler
    vector BusFault_Handler
    vector UsageFault_Handler
    .rept 4
    .word unhandled + 1
    .endr
    vector SVC_Handler
    .word unhandled + 1, unhandled + 1
    vector PendSV_Handler
    vector SysTick_Handler
    .set number, 0
    .rept 86
    interrupt %number
    .set number, number + 1
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

    .global unhandled
    .thumb_func
    .type unhandled, %function
unhandled:
    bkpt 0
    .size unhandled, . - unhandled
