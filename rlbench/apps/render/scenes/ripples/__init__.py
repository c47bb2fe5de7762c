"""Ripples: moving water, glass and a mirror; tests caustics and specular paths."""
