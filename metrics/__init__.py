"""Image metrics: pure functions of tensors that import nothing from the benchmark."""
