"""Parts that scenes share: shapes, textures, materials, glassware and takes."""
