/* The interpreter for machines whose memories add waits. */
#define WAITS true
#define EXECUTE execute_with_waits
#include "execute.c"
