"""Mounts that go where they must not: their own device node stops them, whoever commands."""

import signal
import time

from case import case
from harness import Late, arrived_s, wait

GROUP = "mount beyond its limits: tracking stops"
ALTITUDE_MIN_DEG = 20.0
# two polls of the mount and a slow answer after the end of the slew
STOPPED_S = 3.0


def strange_slew(harness, hour_angle_h: float, dec_deg: float):
    """Another ASCOM client sends the mount somewhere; returns when it has arrived.

    The observatory node is frozen: within a second of the arrival it would send the mount back to its target.
    """
    harness.signal(signal.SIGSTOP, "observatory")
    sidereal_h = harness.wire.get_alpaca("telescope", "siderealtime")
    harness.wire.ask_alpaca("telescope", "slewtocoordinatesasync", RightAscension=(sidereal_h - hour_angle_h) % 24.0,
                            Declination=dec_deg)
    wait("the mount has arrived", lambda: not harness.wire.get_alpaca("telescope", "slewing"), 60, 0.02)


def stopped(harness, since: int):
    arrived = time.time()
    off = wait("tracking is switched off", lambda: [
        put for put in harness.puts("tracking", since) if "false" in str(put).lower()], 20)
    took_s = arrived_s(off[0]) - arrived
    wait("the mount does not track", lambda: not harness.wire.world()["telescope"]["tracking"], 5)
    if took_s > STOPPED_S:
        raise Late(f"tracking was switched off {took_s:.1f} s after the limit was passed, allowed are {STOPPED_S} s")


@case("a stranger slews the mount below its limit while the observatory is frozen", "D8 N12", group=GROUP, may_close=True,
      watch_s=0.0)
def below(harness):
    since = harness.wire.last()
    strange_slew(harness, 5.5, -30.0)
    altitude_deg = harness.wire.world()["telescope"]["altitude_deg"]
    if altitude_deg > ALTITUDE_MIN_DEG:
        raise Late(f"the mount was to go below its limit and stands at {altitude_deg:.1f} deg")
    stopped(harness, since)
    yield


@case("mount ignores a flip and tracks past the meridian on the wrong side, and the observatory is frozen", "D8", group=GROUP,
      may_close=True, watch_s=0.0)
def flip_ignored(harness):
    since = harness.wire.last()
    harness.wire.change("flip", ignored=True)
    side = harness.wire.world()["telescope"]["pier_west"]
    strange_slew(harness, 1.0, -30.0)
    if not side or harness.wire.world()["telescope"]["pier_west"] != side:
        raise Late("the simulated mount was to stay on its side of the pier, looking east")
    stopped(harness, since)
    yield
