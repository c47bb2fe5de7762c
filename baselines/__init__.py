"""Published methods, as near to their papers as we can get: one file each, or one folder."""
