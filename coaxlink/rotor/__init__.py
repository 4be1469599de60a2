"""Rotor models: the ladder SRM, CPCM, R-CRM, CRM, how each is identified, and its file."""

from coaxlink.rotor.model import Effect, PairLoads, RotorModel, load_rotor_model, save_rotor_model
from coaxlink.rotor.polynomial import Polynomial

__all__ = ["Effect", "PairLoads", "Polynomial", "RotorModel", "load_rotor_model", "save_rotor_model"]
