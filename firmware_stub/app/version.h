/**
 * @file version.h
 * @brief Version of the firmware. The version of the link protocol is another number, in protocol/message.h.
 */
#ifndef HILTEST_VERSION_H
#define HILTEST_VERSION_H

#define FIRMWARE_VERSION "0.1.0"

#endif
