"""What stands below the effects: corrections of a given model, and what polynomials of a log's own miss."""
