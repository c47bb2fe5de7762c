"""Path tracing of clips with Mitsuba 3."""
