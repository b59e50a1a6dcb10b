/* Two tasks with floating-point registers of their own; a serial echo; a sensor that is asked who it is; a LED. */
#include "drivers.h"
#include "kernel.h"
#include "registers.h"

enum { TERMS = 400 };

/* What a test reads; a result that differs from the first one of its task was disturbed. */
volatile float first_result[2];
volatile uint32_t rounds[2], disturbed[2], who_am_i;

static float series(float factor)
{
    float sum = 0.0f;
    float term = 1.0f;
    float alternating = 0.0f;

    for (uint32_t i = 0; i < TERMS; i++) {
        sum += term;
        alternating = term - alternating;
        term *= factor;
    }
    return sum + alternating;
}

static void compute(uint32_t task, float factor)
{
    const float result = series(factor);

    if (rounds[task] == 0u) {
        first_result[task] = result;
    } else if (first_result[task] != result) {
        disturbed[task]++;
    }
    rounds[task]++;
}

static void blink_and_compute(void)
{
    uint32_t next = 5u;

    for (;;) {
        compute(0, 0.999f);
        if (kernel_ticks() >= next) {
            GPIOB_PTOR = 1u << 22;
            next += 5u;
        }
    }
}

static void say(const char *text)
{
    while (*text != '\0') {
        if (uart_put((uint8_t)*text)) {
            text++;
        } else {
            kernel_yield();
        }
    }
}

static void echo_and_compute(void)
{
    uint8_t value;

    i2c_read_register(0x0Eu, 0x07u);
    while (!i2c_answer(&value)) {
        kernel_yield();
    }
    who_am_i = value;
    say("ready\n");
    for (;;) {
        compute(1, 0.75f);
        while (uart_get(&value)) {
            const bool letter = value >= 'a' && value <= 'z';
            char answer[2] = {(char)(letter ? value - 'a' + 'A' : value), '\0'};

            say(answer);
        }
    }
}

int main(void)
{
    clock_start();
    CPACR |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    SCGC5 |= 1u << 10;
    PORTB_PCR(22) = 1u << 8;
    GPIOB_PSOR = 1u << 22;
    GPIOB_PDDR = 1u << 22;
    uart_start();
    i2c_start();
    timer_start();
    kernel_start(blink_and_compute, echo_and_compute);
}
