"""Profile of one function of an ELF, for people and for machines."""
