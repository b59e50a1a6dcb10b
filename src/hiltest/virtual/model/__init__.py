"""What instructions cost: tables of clock cycles, and the files that hold them."""
