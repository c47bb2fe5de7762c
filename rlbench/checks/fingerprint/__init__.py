"""What each buffer is worth to a method: dB lost when it is dropped, late, shifted or noisy."""
