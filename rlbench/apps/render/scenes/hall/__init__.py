"""Hall: tubes and about a thousand small lamps; tests many lights and metal."""
