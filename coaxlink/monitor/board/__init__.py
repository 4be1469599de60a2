"""The mixer table on board: what it is, reading it, comparing and writing it."""
