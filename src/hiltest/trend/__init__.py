"""Each measurement over the runs of a folder."""
