"""Repetitions of the papers' experiments: printed figures that can be reproduced, and others that cannot."""

NAMES = ("budget", "choose", "compensation", "constraints", "dpi", "ellipsoids", "estimators", "float32", "imu")
"""Names of all studies; each is the constant STUDY of a module of that name in this package."""
