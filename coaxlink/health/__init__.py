"""Is every rotor still what the model says? Over one flight or many, and in the air, with a probability."""
