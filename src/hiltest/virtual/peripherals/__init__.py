"""The peripherals of the MK64F, and the `bus` that passes register accesses to them."""
