/* Loops that wait, and loops that only look as if they did. -DLOOP names the one that runs, over and over. */
#include <stdint.h>

#define WORD(address) (*(volatile uint32_t *)(address))
#define BYTE(address) (*(volatile uint8_t *)(address))
#define S1 BYTE(0x4006A004u)
#define D BYTE(0x4006A007u)
#define SFIFO BYTE(0x4006A012u)
#define RCFIFO BYTE(0x4006A016u)
#define PDIR_C WORD(0x400FF090u)
#define SYST_CSR WORD(0xE000E010u)
#define SYST_RVR WORD(0xE000E014u)
#define SYST_CVR WORD(0xE000E018u)
#define ICSR WORD(0xE000ED04u)
#define CYCCNT WORD(0xE0001004u)
#define PIT(channel, offset) WORD(0x40037100u + 0x10u * (channel) + (offset))
#define LDVAL 0x0u
#define CVAL 0x4u
#define TCTRL 0x8u
#define TFLG 0xCu
#define UNMODELLED WORD(0x4003B008u) /* ADC0 */

enum { TDRE = 0x80, TC = 0x40, RDRF = 0x20, IDLE = 0x10, SW2 = 1u << 6 };

volatile uint32_t ticks, expiries, flag, words[4];
volatile float sum;
uint32_t results[64], done;

void SysTick_Handler(void)
{
    ticks++;
    words[ticks & 3] += 3u;
}

void Interrupt48_Handler(void)
{
    PIT(0, TFLG) = 1u;
    expiries++;
    flag = 1u;
}

static void keep(uint32_t value)
{
    results[done++ & 63u] += value;
}

static void prepare(void)
{
    WORD(0xE000ED88u) |= 0xFu << 20;
    __asm volatile("dsb\n isb" ::: "memory");
    WORD(0x40048034u) |= 1u << 10;               /* UART0 */
    WORD(0x40048038u) |= 1u << 11;               /* PORTC */
    WORD(0x4004803Cu) |= 1u << 23 | 1u << 27;    /* PIT, ADC0 */
    WORD(0x4004B018u) = 1u << 8 | 3u;            /* PTC6, pulled up */
    BYTE(0x4006A001u) = 10u;
    BYTE(0x4006A010u) = 0x08u;
    BYTE(0x4006A003u) = 0x0Cu;
    WORD(0xE000EDFCu) |= 1u << 24;
    WORD(0xE0001000u) |= 1u;
    SYST_RVR = 9972u;
    SYST_CVR = 0u;
    SYST_CSR = 7u;
    WORD(0x40037000u) = 0u;
    PIT(0, LDVAL) = 3001u;
    WORD(0xE000E104u) = 1u << (48 - 32);
    PIT(0, TCTRL) = 3u;
    PIT(1, LDVAL) = 777u;
    PIT(1, TCTRL) = 1u;
}

static void poll_status(void)
{
    while (!(S1 & TDRE)) {
    }
    D = 'a';
    while (!(S1 & TC)) {
    }
    keep(ticks);
}

static void count_turns(void)
{
    uint32_t turns = 0;
    D = 'b';
    while (!(S1 & TC)) {
        turns++;
    }
    keep(turns);
}

static void store_turns(void)
{
    D = 'c';
    while (!(S1 & TC)) {
        results[done & 63u]++;
    }
    done++;
}

static void read_what_changes(void)
{
    uint32_t seen = 0;
    for (uint32_t read = 0; read < 3;) {
        if (S1 & RDRF) {
            seen = seen << 8 | D;
            read++;
        } else if (SFIFO & 1u) {
            seen += D;
        }
    }
    keep(seen);
}

/* The same byte again and again is not the same reading: each takes one out of the FIFO. */
static void read_data(void)
{
    uint32_t reads = 0;
    while (RCFIFO < 6u && ticks < 5u) {
    }
    do {
        reads += CYCCNT & 1u;
    } while (D == 'a');
    keep(RCFIFO + reads);
    do {
        __asm volatile("" ::: "memory");
    } while (D == 'b');
    keep(RCFIFO);
}

static void wait_idle(void)
{
    while (!(S1 & IDLE)) {
    }
    keep(D + ticks);
}

static void nested(void)
{
    for (uint32_t outer = 0; outer < 5; outer++) {
        D = (uint8_t)('0' + outer);
        do {
            for (volatile uint32_t inner = 0; inner < outer; inner++) {
            }
            while ((PDIR_C & SW2) == 0 && !(S1 & TC)) {
            }
        } while (!(S1 & TC));
        keep(ticks + outer);
    }
}

static void time_out(void)
{
    for (uint32_t limit = 10; limit < 40000; limit *= 8) {
        uint32_t left = limit;
        D = 'd';
        while (!(S1 & TC) && --left) {
        }
        keep(left);
    }
}

static void two_registers(void)
{
    D = 'e';
    while (!(S1 & TC) && (PDIR_C & SW2)) {
    }
    keep(PDIR_C + ticks);
    while (!(PDIR_C & SW2) && !(S1 & TC)) {
    }
    keep(ticks);
}

static void wait_flag(void)
{
    while (!flag) {
    }
    flag = 0;
    keep(expiries);
}

static void wait_ticks(void)
{
    uint32_t began = ticks;
    while (ticks - began < 3) {
    }
    keep(ticks + expiries);
}

static void wait_ticks_counting(void)
{
    uint32_t began = ticks, turns = 0;
    while (ticks - began < 2) {
        turns++;
    }
    keep(turns);
}

static void wait_words(void)
{
    uint32_t before = words[0] + words[1] + words[2] + words[3];
    uint32_t now;
    do {
        now = 0;
        for (uint32_t index = 0; index < 4; index++) {
            now += words[index];
        }
    } while (now == before);
    keep(now);
}

static void wait_masked(void)
{
    uint32_t seen;
    do {
        __asm volatile("cpsid i" ::: "memory");
        seen = flag;
        __asm volatile("cpsie i" ::: "memory");
    } while (!seen);
    flag = 0;
    keep(expiries + ticks);
}

static __attribute__((noinline)) uint32_t ready(uint32_t mask)
{
    return S1 & mask;
}

static void wait_in_calls(void)
{
    D = 'f';
    while (!ready(TC)) {
    }
    keep(ticks);
}

static void wait_floating(void)
{
    uint32_t began = expiries;
    float more = 0.0f;
    while (expiries - began < 2) {
        more += 1.0f;
    }
    sum += more;
    keep(ticks);
}

static void wait_exclusive(void)
{
    uint32_t old, failed;
    do {
        __asm volatile("ldrex %0, [%2]\n strex %1, %0, [%2]" : "=&r"(old), "=&r"(failed) : "r"(&flag) : "memory");
    } while (!old || failed);
    flag = 0;
    keep(expiries);
}

static void wait_counter(void)
{
    uint32_t began = CYCCNT;
    while (CYCCNT - began < 5000u) {
    }
    keep(CYCCNT - began);
}

static void wait_systick(void)
{
    while (SYST_CVR > 1000u) {
    }
    keep(SYST_CVR);
    while (SYST_CVR <= 1000u) {
    }
    keep(SYST_CVR);
}

static void wait_elapsed(void)
{
    uint32_t began = SYST_CVR & 0xFFFFFFu, elapsed;
    do {
        uint32_t now = SYST_CVR & 0xFFFFFFu;
        elapsed = began >= now ? began - now : began + 9973u - now;
    } while (elapsed < 4321u);
    keep(elapsed);
}

static void wait_count_flag(void)
{
    while (!(SYST_CSR & 1u << 16)) {
    }
    keep(SYST_CVR);
    while (!(ICSR & 1u << 26) && !(SYST_CSR & 1u << 16)) {
    }
    keep(ticks);
}

/* The turn that clears the flag takes longer, and changes nothing else. */
static void clear_count_flag(void)
{
    uint32_t status;
    for (uint32_t turns = 0; turns < 3; turns++) {
        __asm volatile(
            "1: ldr %0, [%1]\n tst %0, #0x10000\n beq 2f\n nop\n nop\n nop\n"
            "2: movs %0, #0\n ldr %0, [%2]\n cmp %0, %3\n bls 1b\n"
            : "=&r"(status) : "r"(0xE000E010u), "r"(&expiries), "r"(expiries + 1u) : "cc");
    }
    keep(CYCCNT);
}

/* What is left behind is of the turn before, and of the one before that. */
static void sliding(void)
{
    uint32_t last = 0, now = 0, before;
    do {
        before = last;
        last = now;
        now = SYST_CVR;
    } while (now > 1000u);
    keep(before);
    keep(last);
    while (SYST_CVR <= 1000u) {
    }
}

/* Where an interrupt comes between the two readings it finds one of this turn and one of the turn before. */
static void two_counters(void)
{
    uint32_t first, second;
    __asm volatile(
        "1: ldr %0, [%2, #8]\n cmp %0, #1000\n bls 2f\n"
        "ldr %1, [%3, #4]\n cmp %1, #0\n bne 1b\n"
        "2:\n"
        : "=&r"(first), "=&r"(second) : "r"(0xE000E010u), "r"(0xE0001000u) : "cc");
    keep(first + second);
    while (SYST_CVR <= 1000u) {
    }
}

/* Something happens every few turns, within a turn too. */
static void crowded(void)
{
    uint32_t rounds = 0;
    PIT(2, LDVAL) = 37u;
    PIT(2, TCTRL) = 3u;
    D = 'j';
    do {
        while (!(PIT(2, TFLG) & 1u) && (PDIR_C & SW2) == (PDIR_C & SW2)) {
        }
        PIT(2, TFLG) = 1u;
        rounds++;
    } while (!(S1 & TC));
    PIT(2, TCTRL) = 0u;
    keep(rounds + CYCCNT);
}

static void wait_timer(void)
{
    while (!(PIT(1, TFLG) & 1u)) {
    }
    PIT(1, TFLG) = 1u;
    keep(PIT(1, CVAL));
    while (PIT(1, CVAL) > 100u) {
    }
    keep(PIT(1, CVAL));
}

static void wait_unmodelled(void)
{
    uint32_t began = ticks;
    while (!(UNMODELLED & 1u) && ticks - began < 2u) {
    }
    keep(ticks);
}

static void toggling(void)
{
    uint32_t state = 0, status;
    D = 'g';
    do {
        __asm volatile("eor %0, %0, #1" : "+r"(state));
        status = S1 & TC;
    } while (!(status && state));
    keep(ticks);
}

static void conditional(void)
{
    uint32_t is, was = 0;
    D = 'h';
    do {
        __asm volatile(
            "ldrb %0, [%2]\n tst %0, #0x40\n ite eq\n moveq %1, #5\n movne %1, #9\n"
            "it ne\n ldrbne %0, [%2, #1]\n"
            : "=&r"(is), "+r"(was) : "r"(0x4006A004u) : "cc");
    } while (was != 9);
    keep(is + was);
}

static void superloop(void)
{
    static uint32_t seen;
    for (uint32_t handled = 0; handled < 4;) {
        if (flag) {
            flag = 0;
            handled++;
        }
        if (ticks != seen) {
            seen = ticks;
            D = 'i';
            handled++;
        }
        if (RCFIFO) {
            keep(S1 + D);
            handled++;
        }
    }
    keep(seen);
}

static void count_down(void)
{
    for (volatile uint32_t left = 1000; left; left--) {
    }
    uint32_t left = 30000;
    do {
        __asm volatile("" : "+r"(left));
    } while (--left);
    keep(ticks);
}

int main(void)
{
    prepare();
    for (;;) {
        LOOP();
    }
}
