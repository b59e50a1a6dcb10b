"""The virtual board: an emulated Cortex-M4F with a cycle model, and the MK64F's peripherals.

`hiltest.virtual.k64f.VirtualK64F` is the whole board; `elf` reads firmware, `calling` calls one function of it, and
`profile_file` reads what instructions cost. Nothing is exported here: who reads an ELF needs no emulator.
"""
