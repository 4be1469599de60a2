"""Figures and how they look: one file a kind of picture."""
