"""Tables, plots and pages made from the results table; imports no torch."""
