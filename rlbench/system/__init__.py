"""Where files are kept, what machine this is, and what code decides a number."""
