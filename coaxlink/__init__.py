"""coaxlink: rotor models, mixer tables and live mixing for coaxial multirotors."""

__version__ = "0.1.0"
