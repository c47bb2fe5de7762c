"""Import frames of other renderers as clips: one module per format, and one that writes clips."""
