"""Pure functions of tensors that score an image; imports nothing of ours."""
