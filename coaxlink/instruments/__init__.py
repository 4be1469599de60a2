"""What of a log is no reading, found before anything is inferred from it: for every verb alike."""
