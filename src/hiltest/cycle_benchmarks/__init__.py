"""Device cycles in pytest-benchmark: its fixture's clock, its tables and its JSON."""
