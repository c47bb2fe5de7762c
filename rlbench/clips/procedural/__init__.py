"""A procedural clip: a small animated scene in closed form, computed when it is read."""
