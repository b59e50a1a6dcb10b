/* What entries and returns do to the sets of exceptions. */
#ifndef HILTEST_NVIC_H
#define HILTEST_NVIC_H

#include "state.h"

/* Make an exception active; it is not pending any more. */
void begin_exception(struct core *core, int32_t exception);
/* End the exception that became active last. An interrupt whose line is still high becomes pending again. */
void end_exception(struct core *core);
/* The exception that became active last, or EXCEPTION_NONE. */
int32_t last_active(const struct core *core);
/* Number of active exceptions, within the bounds of the list. */
int32_t active_exceptions(const struct core *core);

#endif
