"""Edits of the firmware that engineers make by mistake, each of which the gate set must find."""
