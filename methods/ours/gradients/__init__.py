"""How good are gradient estimators of a sampler? Bias and noise against an exact gradient."""
