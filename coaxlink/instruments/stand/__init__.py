"""Stands: repeats, spikes, then a chain of ways in which cells and tachometers lie."""
