"""The link to a board: frames, messages, requests with deadlines, and serial ports."""
