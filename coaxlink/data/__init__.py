"""Readers: stand logs and flight logs, whatever wrote them, as one table with units in every name."""

from coaxlink.data.samples import Samples
from coaxlink.data.stand import read_stand_log

__all__ = ["Samples", "read_stand_log"]
