"""Path tracing of clips with Mitsuba 3: probe, load, move, trace, look, record."""
