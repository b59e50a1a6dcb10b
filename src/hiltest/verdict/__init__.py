"""What a run means: its evidence, causes of failures, the comparison with a baseline, and the one sentence."""
