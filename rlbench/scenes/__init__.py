"""Scenes that need no download: four to test on, and a generator of others to train on."""
