/* A compass of sorts: a heading that moves in every round, and a calibration that is written in small steps. */
#include <stdint.h>

#define CPACR (*(volatile uint32_t *)0xE000ED88)
#define SLOW 400
#define FIRST_POINTED_AT 20

struct calibration {
    volatile float hard_iron[3];
    volatile uint32_t solution;
};

struct calibration calibration;
struct calibration *volatile newest;
volatile float heading_rad;
volatile uint32_t rounds, faults_at;
volatile uint8_t is_calibrated;
volatile struct { float x, y, z; } field_nt = { 20000.0f, -1000.0f, 43000.0f };
int16_t acceleration_mg[3] = { 3, -4, 1000 };

static void wait(uint32_t count)
{
    for (volatile uint32_t k = 0; k < count; k++) {
    }
}

/* All three are the number of the solution, when it is done. */
__attribute__((noinline)) void update_calibration(void)
{
    uint32_t solution = calibration.solution + 1;

    for (int axis = 0; axis < 3; axis++) {
        calibration.hard_iron[axis] = (float)solution;
        wait(SLOW);
    }
    calibration.solution = solution;
    if (solution == FIRST_POINTED_AT)
        newest = &calibration;
    is_calibrated = 1;
}

/* Calls itself, so that its return address is reached again and again with other stack pointers. */
__attribute__((noinline)) uint32_t depth(uint32_t n)
{
    uint32_t below = n ? depth(n - 1) : 0;

    rounds++;
    return below + 1;
}

__attribute__((noinline)) void never_called(void)
{
    is_calibrated = 2;
}

int main(void)
{
    CPACR |= 0xFu << 20;
    __asm volatile("dsb\n isb");
    for (;;) {
        update_calibration();
        heading_rad += 0.001f;
        depth(3);
        wait(SLOW);
        if (rounds == faults_at) {
            never_called();
            *(volatile uint32_t *)0xF0000000 = 1;
        }
    }
}
