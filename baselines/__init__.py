"""Published methods, as close to their papers as possible: one module or one package each."""
