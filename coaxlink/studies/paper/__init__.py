"""The paper against its own numbers: what it prints, what those numbers give, and the verdict on each.

Berra, Trujillo Soto and Heredia, Aerodynamic Interaction Minimization in Coaxial Multirotors via Optimized
Control Allocation, Drones 2024, 8(9), 446. What it prints stands in `printed.toml`; nothing that is called
computed here is copied from it.
"""

from coaxlink.studies.paper.laws import printed_laws
from coaxlink.studies.paper.ledger import Claim, Ledger, Line, printed

__all__ = ["Claim", "Ledger", "Line", "printed", "printed_laws"]
