"""Readings that are old although the message is new, slow inputs, and two nodes that speak for one input."""

import signal
import time

from case import Bound, case
from harness import wait

# longer than any input may be silent
STALL_S = 12.0
STALLED = Bound("monitor's node stands still, and the sky turns meanwhile", 7.0)
SLOW = Bound("weather station needs 1.2 s per property, and it rains", 8.0)


def stands_still(turns_after_s: float):
    """What the node read before it stood still is no word about now, however new the state is that brings it."""
    def run(harness):
        harness.mark()
        harness.signal(signal.SIGSTOP, "hands")
        time.sleep(turns_after_s)
        harness.wire.change("safety", unsafe=True)
        time.sleep(STALL_S - turns_after_s)
        harness.signal(signal.SIGCONT, "hands")
        opened = []
        until = time.monotonic() + 10.0
        since = harness.wire.last()
        while time.monotonic() < until:
            opened += [put for put in harness.wire.puts(since) if put["member"] == "openshutter"]
            if opened:
                raise AssertionError("the dome was opened on what was read before the stall")
            time.sleep(0.1)
        yield
    return run


case("monitor's node stands still for 12 s and the sky turns: nothing opens on its old word", "S2 N2 N18",
     STALLED)(stands_still(6.0))


@case("every property of the weather station takes 1.2 s, and it rains", "S2 S7", SLOW)
def slow_station(harness):
    harness.wire.fault("observingconditions", slow_ms=1200)
    time.sleep(25.0)  # the node has learnt how slow it is
    if harness.wire.open_fraction() < 1.0:
        # one look at this station takes some 16 s, and a dome that closed as it became slow opens after the second good one
        wait("the dome is open with a slow station", lambda: harness.wire.open_fraction() == 1.0, 90)
    harness.mark()
    # below what the simulated monitor itself calls unsafe, so that the station alone speaks
    harness.wire.change("weather", Humidity=85.0)
    yield
