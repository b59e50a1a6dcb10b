"""Judgement of calibrators in worlds with a known truth: errors against the bound, refusals, and cost."""
