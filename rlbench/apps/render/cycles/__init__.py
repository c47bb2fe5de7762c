"""Cycles, Blender's path tracer, as a second renderer; it is GPL and runs in its own process."""
