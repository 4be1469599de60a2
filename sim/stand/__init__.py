"""The virtual thrust stand: what is run on it, what is true of it, its grid of steady points."""
