#include "build_id.h"

#ifndef HILTEST_BUILD_ID
#error "build with build.py, which works out HILTEST_BUILD_ID"
#endif

const char build_id[] = HILTEST_BUILD_ID;
