/* One calibrator over one cloud, for any Cortex-M4F with RAM at 0 and at 0x20000000, and without a peripheral. */
#include <stdint.h>

#include "calibration/magnetometer_calibrator.h"

extern const int16_t cloud[][3];
extern const magnetometer_points_t cloud_points;
extern uint32_t stack_top;

void KERNEL(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void start(void);
void run_kernel(void);
void after_kernel(void);

static magnetometer_fit_t fit;

__attribute__((section(".vectors"), used)) const uintptr_t vectors[] = {(uintptr_t)&stack_top, (uintptr_t)start};

__attribute__((noinline)) void run_kernel(void)
{
    KERNEL(&cloud_points, &fit);
    __asm volatile("" ::: "memory"); /* keeps the call from becoming a jump */
}

__attribute__((noinline)) void after_kernel(void)
{
    __asm volatile("movs r0, #0x18\n\tldr r1, =0x20026\n\tbkpt 0xab" ::: "r0", "r1"); /* semihosting: exit */
}

void start(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    /* Written out, so that exactly one instruction lies between the two functions. */
    __asm volatile("bl run_kernel\n\tbl after_kernel" ::: "r0", "r1", "r2", "r3", "r12", "lr", "memory");
}
