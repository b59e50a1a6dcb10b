"""Coverage of uninstrumented firmware: executed lines, functions and branches."""
