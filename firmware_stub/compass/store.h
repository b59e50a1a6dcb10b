/** @file store.h @brief The calibration that survives a reset, and the typed line that stores it. */
#ifndef COMPASS_STORE_H
#define COMPASS_STORE_H

#include "compass.h"

/** Take the calibration that was saved; false when there is none, and nothing changes. */
bool store_load(iron_t *iron);

/** Save a calibration, which may take seconds; false when the memory did not take it. */
bool store_save(const iron_t *iron);

/** Tell whether this line was typed since the last call; another line is dropped. Always false on a board that listens to nobody. */
bool typed_line_is(const char *text);

#endif
