"""The peripherals of the MK64F, one module each, and the `bus` that passes register accesses to them."""
