"""The record of the live loop, ended while the thread that fills it is at its last demand."""

from __future__ import annotations

import os
import threading

from coaxlink.data.logs.live_record import MAGIC, RECORD
from coaxlink.live.record import LiveRecord

ROW = (7, 1.0, [0.0] * 4, [0.5] * 8, [0.0] * 4, 0.001, "live")


def rows_of(path):
    """How many records a file holds behind its two lines of heading."""
    held = path.read_bytes().removeprefix(MAGIC).partition(b"\n")[2]
    assert len(held) % RECORD.size == 0
    return len(held) // RECORD.size


def test_a_record_that_is_closed_while_another_thread_writes_it_holds_every_row_once(tmp_path, monkeypatch):
    path, ends, real = tmp_path / "mix.live", [], os.write
    record = LiveRecord(path, {"rotors": 8})
    record.add(*ROW)

    def slow(file, waiting):
        """The other thread comes to its end while these bytes are on their way."""
        with memoryview(waiting):  # as the system call holds them
            ends.append(threading.Thread(target=record.close))
            ends[-1].start()
            ends[-1].join(0.05)
            return real(file, waiting)

    monkeypatch.setattr("coaxlink.live.record.os.write", slow)
    record.flush()
    monkeypatch.undo()
    for end in ends:
        end.join(10.0)
    assert rows_of(path) == 1


def test_what_comes_after_the_end_is_dropped_and_goes_into_no_other_file(tmp_path):
    path, other = tmp_path / "mix.live", tmp_path / "other"
    record = LiveRecord(path, {"rotors": 8})
    record.add(*ROW)
    record.close()
    with other.open("wb"):  # likely to be given the number that the record's file had
        record.add(*ROW)
        record.tick(1e9)
        record.close()
    assert rows_of(path) == 1 and other.read_bytes() == b""
