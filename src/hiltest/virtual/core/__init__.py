"""The core of the virtual board in C, and its binding for Python."""
