"""Whole runs: folders, the base of a comparison, campaigns over seeds, wire traces."""
