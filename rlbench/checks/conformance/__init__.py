"""What every method must do, each a claim that is tried on a world whose truth is known."""
