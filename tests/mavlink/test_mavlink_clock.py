"""A virtual clock: time passes only where somebody waits, and what is due happens in its order."""

import threading

from coaxlink.mavlink.clock import VirtualClock


def test_what_is_due_happens_in_order_while_somebody_sleeps():
    clock, seen = VirtualClock(10.0), []
    clock.later(2.0, lambda: seen.append(("b", clock.monotonic())))
    clock.later(1.0, lambda: seen.append(("a", clock.monotonic())))
    clock.later(5.0, lambda: seen.append(("late", clock.monotonic())))
    clock.sleep(3.0)
    assert seen == [("a", 11.0), ("b", 12.0)] and clock.monotonic() == 13.0


def test_a_wait_ends_when_the_event_is_set():
    clock, event = VirtualClock(), threading.Event()
    clock.later(0.5, event.set)
    assert not clock.wait(event, 0.4)
    assert clock.wait(event, 10.0) and clock.monotonic() == 1000.5
