"""A city street and its square, with a car."""
