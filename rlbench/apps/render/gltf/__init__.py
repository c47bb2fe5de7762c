"""glTF and GLB files as scenes of Mitsuba, without Blender."""
