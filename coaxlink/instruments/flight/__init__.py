"""Flights: columns against one another, whatever the rotors do; then what the rotors contradict."""
