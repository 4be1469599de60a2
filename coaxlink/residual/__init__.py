"""What the model lacks: residual, noise floor, effects, selection, and the error before and after."""

from coaxlink.residual.refine import refine, refine_stand
from coaxlink.residual.result import Refinement

__all__ = ["Refinement", "refine", "refine_stand"]
