"""Rendering: scenes as data, tracers of Mitsuba 3 and Cycles, and the jobs that render clips."""
