"""Dome and mount that hang, fail, stick or lie while they are needed."""

import time

from case import DOME_FAULT, MOUNT, UNCOMMANDED, case
from harness import Late, wait

ALONE = "mount or dome at fault for a while, sky safe"


def with_unsafe(kind, heal_after_s=None, **fault):
    """The device is at fault, and then the sky turns."""
    def run(harness):
        harness.wire.fault(kind, **fault)
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        if heal_after_s is not None:
            time.sleep(heal_after_s)
            harness.wire.fault(kind)
        yield
    return run


FAULTS = {"refuses": {"refuse": True}, "hangs": {"hang": True}, "answers after 30 s": {"slow_ms": 30_000},
          "answers HTML": {"html": True}, "answers errors": {"error": 0x500}, "says NaN": {"nan": True},
          "is frozen": {"stale": True}}
for word, fault in FAULTS.items():
    case(f"mount {word}, and it is unsafe", "D1 D2 D5 D7", MOUNT,
         short=word in ("refuses", "hangs", "answers after 30 s", "says NaN"))(with_unsafe("telescope", **fault))
case("park never ends, and it is unsafe", "D7", MOUNT)(
    with_unsafe("telescope", stale=True, only=["atpark", "slewing", "devicestate"]))
case("mount refuses to park, and it is unsafe", "D7", MOUNT, short=False)(
    with_unsafe("telescope", error=0x500, only=["park", "abortslew", "tracking"]))


@case("mount's park flag lies, and it is unsafe", "D7", MOUNT)
def lying_park(harness):
    harness.wire.change("park", lies=True)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


for word, fault in FAULTS.items():
    if word == "is frozen":
        continue
    # the request must arrive at once and again until it is obeyed: within 15 s of the healing
    case(f"dome {word} for 8 s, and it is unsafe", "D1 D2 D4", DOME_FAULT, close_within_s=15.0 + 3.0,
         short=word in ("refuses", "hangs", "answers HTML"))(with_unsafe("dome", heal_after_s=8.0, **fault))
case("dome is frozen at open for 8 s, and it is unsafe", "D4 D5", DOME_FAULT, close_within_s=18.0)(
    with_unsafe("dome", heal_after_s=8.0, stale=True))


@case("shutter sticks half way for 12 s, and it is unsafe", "D4 D5", DOME_FAULT, close_within_s=15.0 + 3.0)
def sticks(harness):
    harness.wire.change("shutter", sticks_half_open=True)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    wait("the shutter sticks", lambda: harness.wire.open_fraction() == 0.5, 10)
    time.sleep(12.0)
    harness.wire.change("shutter", sticks_half_open=False)
    yield


@case("shutter half closed and in error, then the observatory dies", "D4 N1", DOME_FAULT, close_within_s=18.0, short=False)
def sticks_and_dies(harness):
    harness.wire.change("shutter", sticks_half_open=True)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    wait("the shutter sticks", lambda: harness.wire.open_fraction() == 0.5, 10)
    t0 = harness.t0
    harness.kill("observatory")
    harness.t0 = t0
    time.sleep(11.0)
    harness.wire.change("shutter", sticks_half_open=False)
    yield


@case("dome loses its connection, and it is unsafe", "D9", DOME_FAULT, close_within_s=18.0)
def dome_disconnected(harness):
    harness.wire.change("connection", lose="dome")
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


@case("somebody else opens the closed dome", "D6 D12", UNCOMMANDED)
def stranger_opens(harness):
    since = harness.wire.last()
    harness.wire.change("safety", unsafe=True)
    wait("closed", lambda: harness.puts("closeshutter", since) and harness.wire.open_fraction() == 0.0, 15)
    time.sleep(2.5)
    harness.mark()
    harness.wire.ask_alpaca("dome", "openshutter")
    yield


def alone(kind, seconds, **fault):
    """At fault for a while under a safe sky: whatever it does, the night goes on afterwards."""
    def run(harness):
        harness.wire.fault(kind, **fault)
        time.sleep(seconds)
        harness.wire.fault(kind)
        yield
    return run


case("mount refuses for 6 s", "D3", group=ALONE, may_close=True)(alone("telescope", 6.0, refuse=True))
case("dome refuses for 6 s", "D3", group=ALONE, may_close=True)(alone("dome", 6.0, refuse=True))
case("mount hangs for 6 s", "D3 D1", group=ALONE, may_close=True, short=False)(alone("telescope", 6.0, hang=True))
case("dome hangs for 6 s", "D3 D1", group=ALONE, may_close=True, short=False)(alone("dome", 6.0, hang=True))


@case("focuser at fault, and the observatory restarts: the night goes on", "D1 N1", group=ALONE, may_close=True, watch_s=0.0)
def focuser_away(harness):
    harness.wire.fault("focuser", html=True)
    harness.restart("observatory")
    harness.exposes()
    yield


@case("camera never says that an image is ready", "D10", group=ALONE, may_close=True, short=False)
def no_image(harness):
    harness.wire.fault("camera", stale=True, only=["imageready", "camerastate", "devicestate"])
    time.sleep(10.0)
    harness.wire.fault("camera")
    yield


@case("device that vanishes and returns: mount not connected any more", "D9", group=ALONE, may_close=True)
def vanishes(harness):
    harness.wire.change("connection", lose="telescope")
    time.sleep(3.0)
    if not harness.wire.requests():
        raise Late("the simulator counts no requests")
    yield
