"""Costs of instructions: tables of clock cycles, and their files."""
