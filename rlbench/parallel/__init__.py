"""Where jobs run: in this process, or on many by Ray."""
