"""Coverage of firmware without instrumentation: executed lines, functions and branches."""
