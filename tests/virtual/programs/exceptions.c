/* Two exceptions that disturb a floating-point computation: SysTick asks for PendSV, which uses the FPU too. */
#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define CPACR REGISTER(0xE000ED88u)
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define ICSR REGISTER(0xE000ED04u)
#define SHPR3 REGISTER(0xE000ED20u)

volatile uint32_t ticks, switches, calls, number_in_handler;
volatile float disturbed = 1.0f;
float result;

void SysTick_Handler(void)
{
    ticks++;
    ICSR = 1u << 28; /* PendSV, after this handler */
}

void PendSV_Handler(void)
{
    switches++;
    for (int i = 0; i < 8; i++) {
        disturbed = disturbed * 1.5f + 2.0f;
    }
    disturbed = 1.0f;
}

void SVC_Handler(void)
{
    uint32_t number;
    __asm volatile("mrs %0, ipsr" : "=r"(number));
    number_in_handler = number;
    calls++;
}

float series(uint32_t terms)
{
    float sum = 0.0f;
    float term = 1.0f;
    for (uint32_t i = 1; i <= terms; i++) {
        sum += term;
        term *= 0.999f;
    }
    return sum;
}

int main(void)
{
    CPACR |= 0xFu << 20;
    __asm volatile("dsb\n\tisb");
    SHPR3 = 0xF0u << 16; /* PendSV least urgent, SysTick most */
    SYST_RVR = 999u;
    SYST_CVR = 0u;
    SYST_CSR = 7u;
    result = series(20000u);
    SYST_CSR = 0u;
    __asm volatile("svc 0");
    return 0;
}
