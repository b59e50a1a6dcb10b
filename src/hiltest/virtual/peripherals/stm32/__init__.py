"""Blocks of the STM32F4 series, from its reference manuals (RM0383 for the STM32F411, RM0090 for the STM32F407)."""
