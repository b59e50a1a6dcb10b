"""Recorded readings of sensors from files: text tables, and streams of NXP's packets."""
