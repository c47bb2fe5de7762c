"""Temple: sun through pierced screens into arcades; tests indirect light, gloss and moving cloth."""
