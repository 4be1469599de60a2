"""A false vehicle that plays a recording to whoever speaks to it."""

import socket
import threading
import time
from contextlib import contextmanager

PAUSE_S = 0.05  # between two rounds of the recording


@contextmanager
def player(frames):
    """Yield the port at which the false vehicle listens."""
    stop = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as false:
        false.bind(("127.0.0.1", 0))
        false.settimeout(0.1)

        def play():
            while not stop.is_set():
                try:
                    peer = false.recvfrom(4096)[1]
                except TimeoutError:
                    continue
                for frame in frames:
                    false.sendto(frame, peer)
                time.sleep(PAUSE_S)

        thread = threading.Thread(target=play)
        thread.start()
        try:
            yield false.getsockname()[1]
        finally:
            stop.set()
            thread.join()
