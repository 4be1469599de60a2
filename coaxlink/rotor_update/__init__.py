"""A rotor model's coefficients updated by flights, and the flight that would tell most of them next."""
