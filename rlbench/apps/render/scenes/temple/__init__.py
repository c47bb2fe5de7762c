"""Temple: arcades lit through pierced screens; tests indirect light, gloss and moving cloth."""
