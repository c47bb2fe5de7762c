"""City: sunlit trees, windows, metal and cars; tests foliage, thin geometry and motion."""
