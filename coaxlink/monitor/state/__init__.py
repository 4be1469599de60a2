"""What is made of it: from what was heard, and the vehicle's own models, one frozen moment for the screen."""
