"""Rendering by Mitsuba 3: scenes, tracers, auxiliary buffers and sample pools."""
