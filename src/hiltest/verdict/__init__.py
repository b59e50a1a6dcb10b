"""The verdict of a run: its evidence, causes of failures, the comparison with a baseline, and one sentence."""
