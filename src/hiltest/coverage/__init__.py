"""Coverage of firmware that was not instrumented: the lines, functions and branches that a run has walked."""
