"""The simulator as a process of its own: up, down, and what is said when it is not."""

import pytest

from coaxlink.errors import LinkError
from coaxlink.mavlink import connect
from coaxlink.studies.simulator import simulator


def test_it_answers_and_goes_with_the_block():
    with simulator(["--speed", "5"]) as address, connect(address) as session:
        assert session.identity.is_px4
    with pytest.raises(LinkError, match="no autopilot heard"):
        connect(address, timeout_s=0.5)


def test_a_start_that_fails_says_why(tmp_path):
    with (
        pytest.raises(LinkError, match=r"did not start: coaxlink: .*nothing\.toml"),
        simulator(["--airframe", str(tmp_path / "nothing.toml")]),
    ):
        pass
