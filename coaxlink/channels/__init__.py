"""From a log to what was measured and what the model gives, row by row, and how far both may be off."""
