"""Where numba keeps the law's compiled code in the folder of this very source: not by where the source lies.

Checkouts and installs of one source share what one of them compiled.
"""

from __future__ import annotations

from pathlib import Path

from numba.core.caching import UserProvidedCacheLocator


class BySource(UserProvidedCacheLocator):
    """In `numba.config.CACHE_DIR`, by the name of the source's own folder."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """As numba asks for it, without a hash of the path."""
        return Path(py_file).parent.name
