"""Blocks of columns with priors, noise with colour, their marginal likelihood, errors on rows held out."""
