"""The virtual FRDM-K64F: the chip, the parts around it, and a debugger for it."""
