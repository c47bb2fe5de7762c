"""Many machines as the engine of a command: --engine ray."""
