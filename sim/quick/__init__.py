"""Whole flights in one compiled loop: the plant, PX4's loops and mix, sensors, gusts."""
