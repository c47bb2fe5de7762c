"""Proving what a clip's buffers mean: conventions, independence, noise."""
