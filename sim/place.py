"""Where on Earth a vehicle's home is: level north and east metres from there to degrees, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

M_PER_DEG = 111319.49


@dataclass(frozen=True)
class Place:
    """Degrees, and metres above mean sea level; it is the origin of the local frame."""

    lat: float = 47.397742
    lon: float = 8.545594
    alt: float = 488.0

    def geodetic(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude, degrees."""
        lon = self.lon + east / (M_PER_DEG * math.cos(math.radians(self.lat)))
        return self.lat + north / M_PER_DEG, lon

    def local(self, lat: float, lon: float) -> tuple[float, float]:
        """North and east, m."""
        return (lat - self.lat) * M_PER_DEG, (lon - self.lon) * M_PER_DEG * math.cos(math.radians(self.lat))


HOME = Place()
