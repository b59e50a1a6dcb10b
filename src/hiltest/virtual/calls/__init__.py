"""Calls of functions: those that the host makes, and those that it watches while firmware runs."""
