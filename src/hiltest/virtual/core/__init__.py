"""The core of the virtual board in C, and its binding: `library` loads both."""
