"""Mounts that go where they must not: their own device node stops them, whoever commands."""

import time

from case import case
from rig import Late, arrived_s, wait

GROUP = "mount beyond its limits: tracking stops"
ALTITUDE_MIN_DEG = 20.0
# two polls of the mount and a slow answer after the end of the slew
STOPPED_S = 3.0


def strange_slew(rig, hour_angle_h: float, dec_deg: float):
    """Another ASCOM client sends the mount somewhere; returns when it has arrived."""
    sidereal_h = rig.wire.get_alpaca("telescope", "siderealtime")
    rig.wire.ask_alpaca("telescope", "slewtocoordinatesasync", RightAscension=(sidereal_h - hour_angle_h) % 24.0,
                        Declination=dec_deg)
    wait("the mount has arrived", lambda: not rig.wire.get_alpaca("telescope", "slewing"), 60, 0.02)


def stopped(rig, since: int):
    arrived = time.time()
    off = wait("tracking is switched off", lambda: [
        put for put in rig.puts("tracking", since) if "false" in str(put).lower()], 20)
    took_s = arrived_s(off[0]) - arrived
    wait("the mount does not track", lambda: not rig.wire.world()["telescope"]["tracking"], 5)
    if took_s > STOPPED_S:
        raise Late(f"tracking was switched off {took_s:.1f} s after the limit was passed, allowed are {STOPPED_S} s")


@case("a stranger slews the mount below its limit while the observatory is stopped", "D8 N12", group=GROUP, may_close=True,
      watch_s=0.0)
def below(rig):
    since = rig.wire.last()
    strange_slew(rig, 5.5, -30.0)
    altitude_deg = rig.wire.world()["telescope"]["altitude_deg"]
    if altitude_deg > ALTITUDE_MIN_DEG:
        raise Late(f"the mount was to go below its limit and stands at {altitude_deg:.1f} deg")
    stopped(rig, since)
    yield


@case("mount ignores a flip and tracks past the meridian on the wrong side", "D8", group=GROUP, may_close=True, watch_s=0.0)
def flip_ignored(rig):
    since = rig.wire.last()
    rig.wire.change("flip", ignored=True)
    side = rig.wire.world()["telescope"]["pier_west"]
    strange_slew(rig, 1.0, -30.0)
    if not side or rig.wire.world()["telescope"]["pier_west"] != side:
        raise Late("the simulated mount was to stay on its side of the pier, looking east")
    stopped(rig, since)
    yield
