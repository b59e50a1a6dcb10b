/**
 * @file server.h
 * @brief Takes requests from the UART, executes each once, and answers.
 */
#ifndef HILTEST_SERVER_H
#define HILTEST_SERVER_H

#include <stdint.h>

typedef struct {
    uint32_t frames;   /**< requests that arrived whole, repeated ones included */
    uint32_t damaged;  /**< frames dropped: stuffing, length or CRC wrong */
    uint32_t repeated; /**< requests answered with the stored reply */
} server_statistics_t;

/** Serve requests for ever. */
_Noreturn void server_run(void);

server_statistics_t server_statistics(void);

/** Reset the board as soon as the reply to the request at hand is out. */
void server_reset_after_reply(void);

#endif
