"""Shapes, sheets, textures, glassware and takes that several scenes use."""
