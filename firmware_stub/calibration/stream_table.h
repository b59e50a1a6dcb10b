/**
 * @file stream_table.h
 * @brief The stream calibrators this firmware offers: one line each, the name on the link and the prefix of type and functions.
 *
 * CAN_REMOVE stands where a point can be taken back, ADD_ONLY where it cannot.
 */
#ifndef HILTEST_STREAM_TABLE_H
#define HILTEST_STREAM_TABLE_H

#include "direct_stream.h"
#include "iterative_stream.h"

#define STREAM_TABLE(LINE) \
    LINE("direct-stream", direct_stream, CAN_REMOVE) \
    LINE("iterative-stream", iterative_stream, ADD_ONLY)

#endif
