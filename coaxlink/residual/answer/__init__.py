"""From what was chosen to the answer that is reported, for stands and for flights."""
