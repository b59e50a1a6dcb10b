"""Runs as wholes: the folder that one fills, what it is judged against, and several side by side."""
