"""Render jobs: which frames, references and sample pools are missing, and who traces them."""
