"""What was chosen, held to its own numbers and to its rivals."""
