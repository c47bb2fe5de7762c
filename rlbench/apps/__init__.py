"""Apps on top of the benchmark: each a folder with its commands; the benchmark imports none."""
