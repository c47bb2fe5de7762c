"""Cycles, Blender's path tracer, as a second tracer: in a process of its own, for it is GPL."""
