"""Rendering with Mitsuba 3: variants, scenes, tracers, G-buffers and sample pools."""
