"""Executors: jobs run in this process, or in parallel on Ray."""
