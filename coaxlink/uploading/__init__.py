"""A table on board, all or nothing: plan, backup, journal, write, read back, verify, restore."""
