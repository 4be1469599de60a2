"""Is every rotor still what the model says? Over one flight or many, with a probability."""

from coaxlink.health.judge import Health, RotorHealth, judge

__all__ = ["Health", "RotorHealth", "judge"]
