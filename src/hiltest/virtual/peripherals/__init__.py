"""The peripherals of the MK64F, one module each, on the `bus` that hands them their register accesses."""
