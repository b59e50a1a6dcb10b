"""The experiments of the papers, to be run again: which figures of theirs come out, and which do not."""

NAMES = ("budget", "choose", "compensation", "constraints", "dpi", "ellipsoids", "estimators", "float32", "imu")
"""Of every study; each is the constant STUDY of a module of that name here."""
