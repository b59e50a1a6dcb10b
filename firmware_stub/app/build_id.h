/**
 * @file build_id.h
 * @brief The sources that this firmware was built from.
 */
#ifndef HILTEST_BUILD_ID_H
#define HILTEST_BUILD_ID_H

/** First 16 hexadecimal digits of the SHA-256 over all sources, build files and the compiler's version. */
extern const char build_id[];

#endif
