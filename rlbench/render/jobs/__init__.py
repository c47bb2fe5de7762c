"""Rendering of clips: which frames, references, pools and pictures, and by what worker."""
