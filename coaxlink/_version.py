"""The version, for rooms that may not import the package itself."""

__version__ = "0.2.0"
