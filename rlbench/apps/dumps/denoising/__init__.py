"""Denoise files of other renderers: shots, loose images, and passes of their light."""

WARM_UP = 16  # frames before a piece of a shot that fill the memory
UNKNOWN_SPP = 8.0  # taken where neither the user nor the file says how many samples a pixel has
