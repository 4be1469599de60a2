"""Rotor models: the ladder SRM, CPCM, R-CRM, CRM, how each is identified, and its file."""

from typing import TYPE_CHECKING, Any

from coaxlink.rotor.model import EffectEntry, PairLoads, RotorModel, load_rotor_model, save_rotor_model
from coaxlink.rotor.polynomial import Polynomial

if TYPE_CHECKING:
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.identification import Identification, identify

__all__ = [
    "EffectEntry",
    "Identification",
    "Options",
    "PairLoads",
    "Polynomial",
    "RotorModel",
    "identify",
    "load_rotor_model",
    "save_rotor_model",
]


def __getattr__(name: str) -> Any:
    # identification brings scipy along: only a caller that uses it waits for it
    if name in ("Identification", "Options", "identify"):
        from coaxlink.rotor import identification

        return getattr(identification, name)
    raise AttributeError(name)
