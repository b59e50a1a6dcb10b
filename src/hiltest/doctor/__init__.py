"""Checks of a bench for faults before anything is measured, each with its remedy."""
