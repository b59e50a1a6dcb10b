/* Computes without end, with integers, with loads and stores, or with floating-point numbers: WORK names which. */
#include <stdint.h>

enum { WORDS = 64, POINTS = 16, TERMS = 3 };

/* A generator of random numbers, and the length of Collatz's sequence behind each. */
uint32_t integer(uint32_t seed)
{
    uint32_t state = seed * 2654435761u + 1, steps = 0;
    for (int round = 0; round < 16; round++) {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        for (uint32_t number = state & 0xFFFF; number > 1; steps++)
            number = number & 1 ? 3 * number + 1 : number >> 1;
    }
    return state + steps;
}

/* Copies, sums of neighbours, and a table of bytes that counts. */
uint32_t load_store(uint32_t seed)
{
    static uint32_t from[WORDS], to[WORDS];
    static uint8_t counts[256];
    from[seed % WORDS] = seed;
    for (int i = 0; i < WORDS; i++)
        to[i] = from[i];
    for (int i = 1; i < WORDS; i++)
        from[i] = to[i] + from[i - 1];
    for (int i = 0; i < WORDS; i++)
        counts[to[i] & 0xFF]++;
    return counts[seed & 0xFF];
}

/* Normal equations of points that are turned and scaled, and their lengths. */
uint32_t floating_point(uint32_t seed)
{
    static float points[POINTS][TERMS], sums[TERMS][TERMS], lengths[POINTS];
    const float turn[TERMS][TERMS] = {{0.36f, 0.48f, -0.8f}, {-0.8f, 0.6f, 0.0f}, {0.48f, 0.64f, 0.6f}};
    for (int p = 0; p < POINTS; p++) {
        const float point[TERMS] = {(float)(seed % 97) - 41.5f, (float)p * 1.7f - 12.0f, 30.25f - (float)(seed % 31)};
        float square = 0.0f;
        for (int row = 0; row < TERMS; row++) {
            points[p][row] = turn[row][0] * point[0] + turn[row][1] * point[1] + turn[row][2] * point[2];
            square += points[p][row] * points[p][row];
        }
        lengths[p] = __builtin_sqrtf(square);
    }
    for (int row = 0; row < TERMS; row++)
        for (int column = 0; column < TERMS; column++)
            for (int p = 0; p < POINTS; p++)
                sums[row][column] += points[p][row] * points[p][column] / (1.0f + lengths[p]);
    return sums[0][0] > 1e6f ? sums[0][0] = sums[1][1] = sums[2][2] = 0.0f, 1 : 0;
}

int main(void)
{
    uint32_t seed = 0;
    stop_watchdog();
    WORD(0xE000ED88u) = 0xFu << 20; /* the FPU may be used */
    for (;;)
        WORK(seed++);
}
