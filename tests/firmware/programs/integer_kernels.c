/* What the calibrators have little of: sorting, tables of jumps, division, multiplication to 64 bits, bit fields. */
#include "calibration/magnetometer_calibrator.h"

enum { ROOM = 512 };

void kernel_sort(const magnetometer_points_t *points, magnetometer_fit_t *fit);
void kernel_interpreter(const magnetometer_points_t *points, magnetometer_fit_t *fit);

static void sift_down(int32_t *heap, uint32_t root, uint32_t count)
{
    for (uint32_t child = 2u * root + 1u; child < count; child = 2u * root + 1u) {
        child += child + 1u < count && heap[child] < heap[child + 1u];
        if (heap[root] >= heap[child]) {
            return;
        }
        const int32_t larger = heap[child];
        heap[child] = heap[root];
        heap[root] = larger;
        root = child;
    }
}

void kernel_sort(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    static int32_t heap[ROOM];
    const uint32_t count = points->count < ROOM ? points->count : ROOM;

    for (uint32_t i = 0; i < count; i++) {
        heap[i] = points->points[i][0] * 4 + points->points[i][1];
    }
    for (uint32_t root = count / 2u; root-- > 0u;) {
        sift_down(heap, root, count);
    }
    for (uint32_t end = count; end-- > 1u;) {
        const int32_t largest = heap[0];
        heap[0] = heap[end];
        heap[end] = largest;
        sift_down(heap, 0, end);
    }
    fit->coverage = (float)heap[count / 2u];
}

/* A program of the points' own bits: a table of jumps, and what each leads to. */
void kernel_interpreter(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    uint64_t product = 1;
    uint32_t sum = 1, crc = 0xFFFFFFFFu;

    for (uint32_t i = 0; i < points->count; i++) {
        const uint32_t word = (uint32_t)points->points[i][2] ^ (uint32_t)points->points[i][0] << 7;
        switch (word & 7u) {
        case 0: sum += word / (sum | 1u); break;
        case 1: product = product * word + sum; break;
        case 2: sum = (uint32_t)((int32_t)word % ((int32_t)(sum & 0xFFu) - 300)); break;
        case 3: crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u))); break;
        case 4: sum ^= __builtin_bswap32(word) + (uint32_t)__builtin_clz(word | 1u); break;
        case 5: product += (uint64_t)((int64_t)(int32_t)word * (int32_t)sum); break;
        case 6: sum = (word >> 5 & 0x1FFu) << 3 | (sum & 7u); break;
        default: product = product >> (word & 31u) | product << 3; break;
        }
    }
    fit->coverage = (float)(sum ^ crc ^ (uint32_t)product ^ (uint32_t)(product >> 32));
}
