"""Bias and noise of gradient estimators of a sampler, against an exact gradient."""
