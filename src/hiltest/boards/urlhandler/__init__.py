"""Handlers of serial URLs, found by pyserial by their names."""
