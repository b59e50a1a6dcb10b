/**
 * @file uart.c
 * @brief UART0 on PTB16/PTB17, the virtual COM port of the on-board debugger: 115200 baud, 8 data bits, no parity.
 *
 * Both directions use the 8-byte FIFOs by interrupt. Received bytes are taken out at 6 in the FIFO, and when the line falls
 * idle, for the tail of a frame.
 */
#include "boards/uart.h"

#include "board_parts.h"
#include "registers.h"
#include "boards/time_base.h"

#define FIFO_BYTES 8u       /* UART0 and UART1 of the K64; the others have 1 */
/* Leaves 2 byte times until the FIFO is full and a third until a byte is lost: 260 us, 31 000 clocks, to come and take them. Other
 * handlers take some hundred clocks; only timed calibrators mask interrupts for longer, and the longest of them for any FIFO. */
#define RECEIVE_WATERMARK 6u
#define BYTE_TIME_US 87u    /* 10 bits at 115200 baud */

/* 120 MHz / (16 * (65 + 3/32)) = 115218 baud, +0.02 % */
#define BAUD_DIVISOR 65u
#define BAUD_FRACTION_32THS 3u

#define C2_RECEIVING (UART0_C2_TE | UART0_C2_RE | UART0_C2_RIE | UART0_C2_ILIE)

/* Holds the longest frame (2066 bytes with every byte escaped), so one that comes while a command runs is not lost. */
#define RECEIVE_BUFFER_BYTES 4096u

/* Counts of bytes since start: taken <= handed_over <= written, at most the buffer apart. They count on and wrap at 2^32. */
static struct {
    uint8_t bytes[RECEIVE_BUFFER_BYTES];
    uint32_t written;              /* by the interrupt alone */
    volatile uint32_t handed_over; /* by the interrupt */
    volatile uint32_t taken;       /* by uart_taken() */
    volatile uint32_t overruns;
} receiver;

static struct {
    const uint8_t *next;
    volatile size_t left;
} transmitter;

void UART0_Handler(void);

void uart_start(void)
{
    SIM_SCGC4 |= SIM_SCGC4_UART0;
    PORT_PCR(PORTB_BASE, 16u) = PORT_PCR_MUX(3);
    PORT_PCR(PORTB_BASE, 17u) = PORT_PCR_MUX(3);

    UART0_C2 = 0u; /* FIFOs may change only while both directions are off */
    UART0_BDH = 0u;
    UART0_BDL = BAUD_DIVISOR;
    UART0_C4 = BAUD_FRACTION_32THS;
    UART0_C1 = UART0_C1_IDLE_AFTER_STOP; /* trailing one bits of the last byte are not idle time */
    UART0_PFIFO = UART0_PFIFO_TXFE | UART0_PFIFO_RXFE;
    UART0_CFIFO = UART0_CFIFO_TXFLUSH | UART0_CFIFO_RXFLUSH;
    UART0_TWFIFO = 0u; /* refill when empty: the shift register still has a byte to send */
    UART0_RWFIFO = RECEIVE_WATERMARK;
    UART0_C3 = UART0_C3_ORIE | UART0_C3_FEIE;
    UART0_C2 = C2_RECEIVING;
    interrupt_enable(IRQ_UART0_STATUS);
    interrupt_enable(IRQ_UART0_ERROR);
}

/** Take a byte out of the FIFO into the buffer; returns whether it ends what is handed over. */
static inline bool keep(uint32_t position)
{
    const uint8_t byte = UART0_D;
    receiver.bytes[position % RECEIVE_BUFFER_BYTES] = byte;
    return byte == UART_LAST_BYTE;
}

/** Take `count` bytes, fewer than the FIFO has. Straight code: a loop costs as much as what it does. */
static inline bool keep_some(uint32_t position, uint32_t count)
{
    bool complete = false;
    switch (count) {
    case 7:
        complete |= keep(position++); /* fall through */
    case 6:
        complete |= keep(position++); /* fall through */
    case 5:
        complete |= keep(position++); /* fall through */
    case 4:
        complete |= keep(position++); /* fall through */
    case 3:
        complete |= keep(position++); /* fall through */
    case 2:
        complete |= keep(position++); /* fall through */
    case 1:
        complete |= keep(position++); /* fall through */
    default:
        return complete;
    }
}

/** Idle just after the FIFO was emptied. Only a read of D clears the flag; of an empty FIFO that is an underflow, which leaves the
 * FIFO's pointers apart until it is flushed. No byte can be lost: the line is idle. */
static void clear_idle(void)
{
    (void)UART0_D;
    UART0_CFIFO = UART0_CFIFO_RXFLUSH;
    UART0_SFIFO = UART0_SFIFO_RXUF | UART0_SFIFO_RXOF;
}

/** Empty the FIFO into the buffer, which has room. Reading S1 and then the last byte clears RDRF, IDLE, OR and FE. */
static inline bool keep_all(uint32_t position, uint32_t waiting, uint8_t *status)
{
    const bool complete = keep_some(position, waiting - 1u);
    *status |= UART0_S1;
    return keep(position + waiting - 1u) | complete;
}

/** The same when there is room for fewer: the others are lost. */
static bool keep_what_fits(uint32_t position, uint32_t waiting, uint32_t room, uint8_t *status)
{
    const bool complete = keep_some(position, room);
    for (uint32_t left = waiting - room; left > 1u; left--) {
        (void)UART0_D;
    }
    *status |= UART0_S1;
    (void)UART0_D;
    return complete;
}

/** Empty the receive FIFO. */
static inline void receive(uint8_t status)
{
    const uint32_t waiting = UART0_RCFIFO;
    if (waiting == 0u) {
        clear_idle();
        return;
    }
    const uint32_t position = receiver.written;
    const uint32_t room = receiver.taken + RECEIVE_BUFFER_BYTES - position;
    const bool fits = waiting <= room;
    const bool complete = fits ? keep_all(position, waiting, &status) : keep_what_fits(position, waiting, room, &status);
    const uint32_t kept = fits ? waiting : room;
    receiver.written = position + kept;
    receiver.overruns += waiting - kept + ((status & (UART0_S1_OR | UART0_S1_FE)) != 0u);
    if (complete | (position + kept - receiver.handed_over >= RECEIVE_BUFFER_BYTES / 2u)) {
        receiver.handed_over = position + kept;
        wait_is_over();
    }
}

/** Send `count` bytes, fewer than the FIFO takes. Straight code, as keep_some(). */
static inline void send_some(const uint8_t *next, uint32_t count)
{
    switch (count) {
    case 7:
        UART0_D = *next++; /* fall through */
    case 6:
        UART0_D = *next++; /* fall through */
    case 5:
        UART0_D = *next++; /* fall through */
    case 4:
        UART0_D = *next++; /* fall through */
    case 3:
        UART0_D = *next++; /* fall through */
    case 2:
        UART0_D = *next++; /* fall through */
    case 1:
        UART0_D = *next++; /* fall through */
    default:
        return;
    }
}

/** Fill the transmit FIFO, which TDRE says is empty; the read of S1 before the last byte clears TDRE. */
static inline void transmit(size_t left)
{
    const size_t count = left < FIFO_BYTES ? left : FIFO_BYTES;
    const uint8_t *const next = transmitter.next;
    send_some(next, count - 1u);
    (void)UART0_S1;
    UART0_D = next[count - 1u];
    transmitter.next = next + count;
    transmitter.left = left - count;
    if (left == count) {
        UART0_C2 = C2_RECEIVING;
        wait_is_over();
    }
}

void UART0_Handler(void)
{
    const uint8_t status = UART0_S1;
    if ((status & (UART0_S1_RDRF | UART0_S1_IDLE | UART0_S1_OR | UART0_S1_FE)) != 0u) {
        receive(status);
    }
    const size_t left = transmitter.left;
    if ((left > 0u) & ((status & UART0_S1_TDRE) != 0u)) {
        transmit(left);
    }
}

static bool bytes_wait(const void *context)
{
    (void)context;
    return receiver.taken != receiver.handed_over;
}

uart_span_t uart_wait_for_bytes(void)
{
    (void)wait_until(bytes_wait, (const void *)0, WAIT_FOREVER);
    const uint32_t first = receiver.taken % RECEIVE_BUFFER_BYTES;
    const uint32_t waiting = receiver.handed_over - receiver.taken;
    const uint32_t to_the_end = RECEIVE_BUFFER_BYTES - first;
    return (uart_span_t){.bytes = &receiver.bytes[first], .count = waiting < to_the_end ? waiting : to_the_end};
}

void uart_taken(size_t count)
{
    receiver.taken += count;
}

void uart_send(const uint8_t *bytes, size_t count)
{
    if (count == 0u) {
        return; /* an interrupt with nothing to send would come for ever */
    }
    transmitter.next = bytes;
    transmitter.left = count;
    UART0_C2 = C2_RECEIVING | UART0_C2_TIE; /* TDRE is set, so the interrupt comes now and sends the first bytes */
}

static bool all_handed_over(const void *context)
{
    (void)context;
    return transmitter.left == 0u;
}

bool uart_wait_until_sent(uint64_t deadline_us)
{
    return wait_until(all_handed_over, (const void *)0, deadline_us);
}

uint32_t uart_drain_us(void)
{
    return (FIFO_BYTES + 1u) * BYTE_TIME_US;
}

uint32_t uart_overruns(void)
{
    return receiver.overruns;
}
