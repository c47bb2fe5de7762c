"""A pinned collection of scenes by others: what there is, where it lies, and how to get it."""
