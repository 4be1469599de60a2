"""A table of cases as one test that tells every failure, not the first alone.

with case_table() as case:
    for name, value in TABLE.items():
        with case(name):
            assert holds(value)
"""

import contextlib

import pytest


@contextlib.contextmanager
def case_table():
    """Yields `case(name)`; fails at the end with all that failed inside one."""
    failures = []

    @contextlib.contextmanager
    def case(name):
        try:
            yield
        except (Exception, pytest.fail.Exception) as error:
            failures.append(f"{name}: {type(error).__name__}: {str(error)[:600]}")

    yield case
    assert not failures, "\n".join(failures)
