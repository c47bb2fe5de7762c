"""Denoise files of other renderers: shots, loose images, and passes of their light."""
