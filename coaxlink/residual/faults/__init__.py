"""Instruments and labels that cannot be what the log says, found before anything is fitted."""
