"""The tables of the chip: memories, peripherals, registers and pins."""
