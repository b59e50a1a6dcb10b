"""The virtual FRDM-K64F: the chip, what is around it, and a debugger for it."""
