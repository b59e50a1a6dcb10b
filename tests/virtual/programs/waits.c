/* Loops that wait, and loops that only look as if they did. -DLOOP names the one that runs, over and over. */
#include <stdint.h>

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
#define UNMODELLED WORD(0x40036000u) /* PDB0 */
#define RNG(offset) WORD(0x40029000u + (offset)) /* CR, SR, ER, OR */
#define CRC(offset) WORD(0x40032000u + (offset)) /* DATA, GPOLY, CTRL */
#define DMA_INT WORD(0x40008024u)
#define DMA_CINT BYTE(0x4000801Fu)
#define TCD(offset) WORD(0x40009000u + (offset))
#define TCD_CSR (*(volatile uint16_t *)0x4000901Cu)

enum { TDRE = 0x80, TC = 0x40, RDRF = 0x20, IDLE = 0x10, SW2 = 1u << 6 };

volatile uint32_t ticks, expiries, flag, words[4];
uint32_t results[64], done;
volatile uint32_t source[256], moved[256];

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
    WORD(0x40048034u) |= 1u << 10;               /* UART0 */
    WORD(0x40048038u) |= 1u << 11;               /* PORTC */
    WORD(0x4004803Cu) |= 1u << 1 | 1u << 9 | 1u << 18 | 1u << 22 | 1u << 23; /* DMAMUX, RNG, CRC, PDB, PIT */
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

/* What a turn counts is in RAM alone when it is over. */
static void count_exclusively(void)
{
    uint32_t counted, failed;
    D = 'l';
    do {
        __asm volatile(
            "ldrex %0, [%2]\n add %0, %0, #1\n strex %1, %0, [%2]\n mov.w %0, #0\n"
            : "=&r"(counted), "=&r"(failed) : "r"(&words[1]) : "memory");
    } while (!(S1 & TC));
    keep(words[1]);
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

/* The timer begins anew, without an event, while the loop waits. */
static void wait_reload(void)
{
    PIT(3, LDVAL) = 1999u;
    PIT(3, TCTRL) = 1u;
    while (PIT(3, CVAL) <= 1500u) {
    }
    keep(CYCCNT);
    while (PIT(3, CVAL) > 500u) {
    }
    keep(CYCCNT);
}

static void wait_for_byte_of_counter(void)
{
    while (BYTE(0xE000E019u) > 5u) {
    }
    keep(CYCCNT);
    while (BYTE(0xE000E019u) <= 5u) {
    }
}

/* A byte of the word that every turn stores, and the byte that a turn stores of a word. */
static void store_and_read_a_part(void)
{
    for (uint32_t begin = 0x1000; begin < 0x9000; begin += 0x1357) {
        uint32_t count = begin, part, status;
        __asm volatile(
            "1: adds %0, #1\n str %0, [%3]\n ldrb %1, [%3]\n ldrb %2, [%4]\n cmp %1, #0x30\n bne 1b\n"
            : "+r"(count), "=&r"(part), "=&r"(status) : "r"(words), "r"(0x4006A004u) : "cc", "memory");
        keep(count);
        __asm volatile(
            "1: adds %0, #1\n strb %0, [%3, #4]\n ldrb %1, [%3, #4]\n ldrb %2, [%4]\n cmp %1, #0x20\n bne 1b\n"
            : "+r"(count), "=&r"(part), "=&r"(status) : "r"(words), "r"(0x4006A004u) : "cc", "memory");
        keep(count);
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

/* Every reading takes a byte, and each comes back with the same. */
static void drain(void)
{
    uint32_t state;
    while (RCFIFO < 7u && ticks < 7u) {
    }
    SFIFO = 1u;
    __asm volatile(
        "1: ldrb %0, [%1, #7]\n ldrb %0, [%1, #0x12]\n tst %0, #1\n beq 1b\n"
        : "=&r"(state) : "r"(0x4006A000u) : "cc", "memory");
    keep(CYCCNT + state);
}

/* The flag rises without an event: nothing interrupts. */
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

/* What was read of the counter is gone when a turn is over. */
static void forget_counter(void)
{
    uint32_t value;
    __asm volatile(
        "1: ldr %0, [%1, #8]\n cmp %0, #1000\n mov.w %0, #0\n bhi 1b\n"
        : "=&r"(value) : "r"(0xE000E010u) : "cc");
    keep(CYCCNT);
    while (SYST_CVR <= 1000u) {
    }
}

/* An interrupt changes memory, which is what the loops look at. */
static void wait_for_interrupt(void)
{
    uint32_t before = expiries;
    while (expiries == before) {
    }
    keep(CYCCNT);
    flag = 0u;
    do {
        before = ticks;
    } while (!flag && before != ~0u);
    keep(CYCCNT);
}

static void start_move(uint32_t control)
{
    source[255] = done + 1u;
    moved[255] = 0u;
    TCD(0x00) = (uint32_t)source;
    TCD(0x04) = 0x02020004u; /* words, the next one each */
    TCD(0x08) = sizeof source;
    TCD(0x10) = (uint32_t)moved;
    TCD(0x14) = 0x00010004u;
    TCD(0x1C) = 0x00010000u | control;
}

static void wait_dma(void)
{
    start_move(1u);
    while (!(TCD_CSR & 0x80u)) {
    }
    keep(CYCCNT);
    start_move(3u);
    while (!(DMA_INT & 1u)) {
    }
    DMA_CINT = 0u;
    keep(CYCCNT);
}

/* The DMA sends: a byte a request of the UART. */
static void wait_dma_sending(void)
{
    TCD(0x00) = (uint32_t)"nine char";
    TCD(0x04) = 1u; /* bytes */
    TCD(0x08) = 1u;
    TCD(0x0C) = 0u;
    TCD(0x10) = 0x4006A007u;
    TCD(0x14) = 9u << 16;
    TCD(0x1C) = 9u << 16 | 0xAu; /* DREQ, INTMAJOR */
    BYTE(0x40021000u) = 0x80u | 3u;
    BYTE(0x4006A00Bu) = 0x80u;
    BYTE(0x4006A003u) = 0x8Cu;
    BYTE(0x4000801Bu) = 0u; /* SERQ */
    while (!(DMA_INT & 1u)) {
    }
    DMA_CINT = 0u;
    BYTE(0x4006A003u) = 0x0Cu;
    keep(CYCCNT);
    while (!(S1 & TC)) {
    }
}

static void wait_random(void)
{
    RNG(0x0) = 1u;
    for (uint32_t words_taken = 0; words_taken < 3; words_taken++) {
        while (!(RNG(0x4) >> 8 & 0xFFu)) {
        }
        keep(CYCCNT ^ RNG(0xC));
    }
}

/* Each reading of an empty OR is an error, which the first reading of SR forgets. */
static void take_random(void)
{
    uint32_t word, turns = 0;
    RNG(0x0) = 1u;
    do {
        word = RNG(0xC);
    } while (!word);
    keep(word + RNG(0x4));
    (void)RNG(0xC);
    while (!(RNG(0x4) & 4u) && turns < 9u) {
        turns++;
    }
    keep(turns + CYCCNT);
    while (RNG(0xC) == 0u || RNG(0x4) & 4u) {
    }
    keep(CYCCNT + RNG(0x4));
    RNG(0x0) = 1u << 3;
}

static void poll_crc(void)
{
    uint32_t began = ticks;
    CRC(0x8) = 0u;
    CRC(0x0) = began + 1u;
    while ((CRC(0x0) & 0xFFFFu) && ticks == began) {
    }
    keep(CRC(0x0) + CYCCNT);
}

static void wait_unmodelled(void)
{
    uint32_t began = ticks;
    while (!(UNMODELLED & 1u) && ticks - began < 2u) {
    }
    keep(ticks);
}

/* What changes from turn to turn is the carry alone. */
static void toggle_carry(void)
{
    uint32_t status, carry;
    D = 'k';
    __asm volatile(
        "1: adc %0, %3, %3\n rsbs %0, %0, #0\n ldrb %0, [%2]\n and %0, %0, #0x40\n cbnz %0, 2f\n b 1b\n"
        "2: adc %1, %3, %3\n"
        : "=&l"(status), "=&r"(carry) : "r"(0x4006A004u), "r"(0u) : "cc");
    keep(carry + ticks);
}

/* What changes from turn to turn is a word of memory alone, without optimisation. */
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

int main(void)
{
    prepare();
    for (;;) {
        LOOP();
    }
}
