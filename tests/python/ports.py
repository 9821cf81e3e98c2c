"""Free ports for servers that are started, ended and started again."""

import pathlib
import random
import socket

# The kernel gives each connection a port of its own range: one taken from there may be gone when its server is started again.
ABOVE = int(pathlib.Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
_given: set[int] = set()


def free_port() -> int:
    """Nobody listens there, no connection gets it, and it is given once."""
    while True:
        port = random.randrange(ABOVE - 12_000, ABOVE)
        with socket.socket() as s:
            try:
                s.bind(("127.0.0.1", port))
            except OSError:
                continue
        if port not in _given:
            _given.add(port)
            return port
