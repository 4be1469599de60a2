"""Flights in the simulated world: the demo, the closed loop, and the cells of a campaign."""
