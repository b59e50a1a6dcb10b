"""Hardware-in-the-loop tests for compass and IMU calibration firmware."""

__version__ = "0.1.0"
