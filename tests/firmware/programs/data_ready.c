/**
 * @file data_ready.c
 * @brief Reads the shield's gyroscope and accelerometer when their interrupt pins say so, and never asks for a status.
 */
#include <stdbool.h>
#include <stddef.h>

#include "boards/board.h"
#include "boards/i2c.h"
#include "boards/time_base.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SIM_SCGC5 REGISTER(0x40048038u)
#define PORT_PCR(base, pin) REGISTER((base) + 4u * (pin))
#define PORT_ISFR(base) REGISTER((base) + 0xA0u)
#define SCB_VTOR REGISTER(0xE000ED08u)
#define NVIC_ISER1 REGISTER(0xE000E104u)
#define PORTA 0x40049000u
#define PORTB 0x4004A000u
#define FALLING_GPIO (0xAu << 16 | 1u << 8)
#define PORTA_IRQ 59u

#define SHIELD 1u
#define SAMPLE_BYTES 6u
#define SAMPLES 200u
#define VECTORS (16u + 86u)

typedef struct {
    uint8_t address;
    uint8_t pin;
    i2c_status_t status; /**< first that was not I2C_OK */
    uint32_t port;
    volatile uint32_t edges;
    uint32_t taken;
    uint8_t samples[SAMPLES * SAMPLE_BYTES];
} part_t;

/* D5 is where the shield leads INT1 of the gyroscope, D2 that of the accelerometer. */
part_t parts[2] = {{.address = 0x20u, .port = PORTA, .pin = 2u}, {.address = 0x1Eu, .port = PORTB, .pin = 9u}};
volatile uint32_t finished;

typedef void (*vector_t)(void);
static vector_t vectors[VECTORS] __attribute__((aligned(512)));

static void edge(part_t *part)
{
    PORT_ISFR(part->port) = 1u << part->pin;
    part->edges++;
    wait_is_over();
}

static void porta_handler(void)
{
    edge(&parts[0]);
}

static void portb_handler(void)
{
    edge(&parts[1]);
}

static void connect(void)
{
    const vector_t *in_flash = (const vector_t *)SCB_VTOR;
    for (uint32_t index = 0u; index < VECTORS; index++) {
        vectors[index] = in_flash[index];
    }
    vectors[16u + PORTA_IRQ] = porta_handler;
    vectors[16u + PORTA_IRQ + 1u] = portb_handler;
    SCB_VTOR = (uint32_t)vectors;
    SIM_SCGC5 |= 3u << 9;
    for (uint32_t index = 0u; index < 2u; index++) {
        PORT_PCR(parts[index].port, parts[index].pin) = FALLING_GPIO;
    }
    NVIC_ISER1 = 3u << (PORTA_IRQ - 32u);
}

static void put(part_t *part, uint8_t reg, uint8_t value)
{
    const i2c_status_t status = i2c_write(SHIELD, part->address, reg, &value, 1u);
    part->status = part->status == I2C_OK ? status : part->status;
}

static void take(part_t *part)
{
    if (part->taken < SAMPLES && part->edges > part->taken && part->status == I2C_OK) {
        part->status = i2c_read(SHIELD, part->address, 0x01u, &part->samples[part->taken * SAMPLE_BYTES], SAMPLE_BYTES);
        part->taken++;
    }
}

static bool something_to_take(const void *context)
{
    (void)context;
    return parts[0].edges > parts[0].taken || parts[1].edges > parts[1].taken;
}

int main(void)
{
    board_start();
    sleep_until_us(70000u); /* the gyroscope boots for 50 ms */
    connect();
    put(&parts[0], 0x14u, 0x0Cu); /* data ready to INT1, active low */
    put(&parts[0], 0x13u, 0x0Au); /* 200 Hz */
    put(&parts[1], 0x2Du, 0x01u); /* data ready, */
    put(&parts[1], 0x2Eu, 0x01u); /* to INT1 */
    put(&parts[1], 0x2Au, 0x11u); /* 200 Hz */
    while (parts[0].taken < SAMPLES || parts[1].taken < SAMPLES) {
        if (!wait_until(something_to_take, NULL, time_us() + 200000u)) {
            break;
        }
        take(&parts[0]);
        take(&parts[1]);
        parts[0].edges = parts[0].taken < SAMPLES ? parts[0].edges : SAMPLES;
        parts[1].edges = parts[1].taken < SAMPLES ? parts[1].edges : SAMPLES;
    }
    finished = 1u;
    for (;;) {
        sleep_until_us(WAIT_FOREVER);
    }
}
