/* Reads the FXOS8700CQ on I2C0 by polling, at 120 MHz, and prints each reading by polling, without a pause. */
#include <stdbool.h>
#include <stdint.h>

#define MCG(offset) BYTE(0x40064000u + (offset))
#define UART(offset) BYTE(0x4006A000u + (offset))
#define I2C(offset) BYTE(0x40066000u + (offset))

enum { C1 = 0, C2 = 1, C5 = 4, C6 = 5, S = 6 };
enum { BDH = 0, BDL = 1, UART_C2 = 3, S1 = 4, D = 7, C4 = 10 };
enum { F = 1, CONTROL = 2, STATUS = 3, DATA = 4 };
enum { ENABLED = 0x80, MASTER = 0x20, SENDING = 0x10, NACK = 0x08, AGAIN = 0x04, DONE = 0x02 };
enum { PART = 0x1D, OUT_X_MSB = 0x01, CTRL_REG1 = 0x2A, READING_BYTES = 6 };

static void clock_120_mhz(void)
{
    WORD(0x40048044u) = 0x01140000u;
    MCG(C2) = 0xA0u;
    MCG(C1) = 0xB8u;
    while ((MCG(S) & 0x1Cu) != 0x08u) {
    }
    MCG(C5) = 0x13u;
    MCG(C6) = 0x40u | 24u;
    while ((MCG(S) & 0x60u) != 0x60u) {
    }
    MCG(C1) = 0x38u;
    while ((MCG(S) & 0x0Cu) != 0x0Cu) {
    }
}

static void print_character(char character)
{
    while (!(UART(S1) & 0x80u)) {
    }
    UART(D) = (uint8_t)character;
}

static void print_number(int number)
{
    char digits[6];
    int count = 0;

    if (number < 0) {
        print_character('-');
        number = -number;
    }
    do {
        digits[count++] = (char)('0' + number % 10);
        number /= 10;
    } while (number != 0);
    while (count > 0) {
        print_character(digits[--count]);
    }
}

static void finish_byte(void)
{
    while (!(I2C(STATUS) & DONE)) {
    }
    I2C(STATUS) = DONE;
}

static void send(uint8_t byte)
{
    I2C(DATA) = byte;
    finish_byte();
}

static void write_register(uint8_t address, uint8_t value)
{
    I2C(CONTROL) = ENABLED | MASTER | SENDING;
    send(PART << 1);
    send(address);
    send(value);
    I2C(CONTROL) = ENABLED;
}

static void read_registers(uint8_t address, uint8_t *bytes, int count)
{
    I2C(CONTROL) = ENABLED | MASTER | SENDING;
    send(PART << 1);
    send(address);
    I2C(CONTROL) = ENABLED | MASTER | SENDING | AGAIN;
    send(PART << 1 | 1);
    I2C(CONTROL) = ENABLED | MASTER;
    (void)I2C(DATA);
    for (int index = 0; index < count; index++) {
        finish_byte();
        if (index == count - 2) {
            I2C(CONTROL) = ENABLED | MASTER | NACK;
        }
        if (index == count - 1) {
            I2C(CONTROL) = ENABLED | MASTER | SENDING;
        }
        bytes[index] = I2C(DATA);
    }
    I2C(CONTROL) = ENABLED;
}

int main(void)
{
    clock_120_mhz();
    WORD(0x40048034u) |= 1u << 10 | 1u << 6;
    UART(BDH) = 0;
    UART(BDL) = 65;
    UART(C4) = 3;
    UART(UART_C2) = 0x0C;
    I2C(F) = 0x65; /* 94 kHz */
    I2C(CONTROL) = ENABLED;
    write_register(CTRL_REG1, 0x01);
    for (;;) {
        uint8_t bytes[READING_BYTES];

        read_registers(OUT_X_MSB, bytes, READING_BYTES);
        for (int axis = 0; axis < READING_BYTES; axis += 2) {
            print_number((int16_t)(bytes[axis] << 8 | bytes[axis + 1]) / 4);
            print_character(axis < 4 ? ' ' : '\n');
        }
    }
}
