"""Generator of random training scenes, one for each seed."""
