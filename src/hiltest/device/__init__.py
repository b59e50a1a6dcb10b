"""Interfaces of devices: what firmware that does not speak the link's protocol says of itself."""
