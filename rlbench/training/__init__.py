"""Training: task, config, loop, checkpoint, dataset and logger."""
