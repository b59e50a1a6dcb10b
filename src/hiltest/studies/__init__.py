"""Studies, which repeat experiments of papers and compare the results with the printed figures."""

NAMES = ("budget", "choose", "compensation", "constraints", "dpi", "ellipsoids", "estimators", "float32", "imu")
"""Names of all studies; the module of the same name has the study as its constant STUDY."""
