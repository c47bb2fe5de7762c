"""Measuring: the run plan, its runner, scores, latency, cost and the results table."""
