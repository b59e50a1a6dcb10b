/* What every program of the tests begins with: registers by their width in C, functions by their names in assembly. */
#ifdef __ASSEMBLER__
    .syntax unified
    .thumb
    .macro function name
    .global \name
    .thumb_func
    .type \name, %function
\name:
    .endm
    .macro ends name
    .size \name, . - \name
    .endm
#else
#define WORD(address) (*(volatile unsigned *)(address))
#define HALF(address) (*(volatile unsigned short *)(address))
#define BYTE(address) (*(volatile unsigned char *)(address))

static inline void stop_watchdog(void)
{
    HALF(0x4005200E) = 0xC520;
    HALF(0x4005200E) = 0xD928;
    HALF(0x40052000) = 0x01D2;
}
#endif
