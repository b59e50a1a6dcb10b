/** @file data_ready.h @brief The magnetometer's data-ready pin, on boards that have it wired. */
#ifndef COMPASS_DATA_READY_H
#define COMPASS_DATA_READY_H

#include <stdbool.h>
#include <stdint.h>

/** Sleep until the pin is high (true) or a timeout passes (false), 1 to 100 000 us. */
bool data_ready_wait(uint32_t timeout_us);

#endif
