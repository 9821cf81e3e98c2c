"""A dome whose turning fails: while it must close, which never waits for it, and while frames are taken through its slit."""

import time

from case import Bound, case
from harness import Late, arrived_s, wait

TURNING = Bound("dome's turning at fault, and unsafe", 3.0, 1.5)
OVERTAKEN = "dome's turning at fault for a while, sky safe"
AWAY_DEG = 90.0
# exposures so long that ending one saves time
LONG = {"flavour": "long", "watch_s": 2.0}


def azimuth_deg(harness) -> float:
    return harness.wire.world()["dome"]["azimuth_deg"]


def slip(harness):
    """The dome stands elsewhere all at once, and knows it."""
    harness.wire.ask_alpaca("dome", "synctoazimuth", Azimuth=(azimuth_deg(harness) + AWAY_DEG) % 360.0)


def asked_to_turn(harness, since: int):
    return wait("the dome is asked to turn back", lambda: harness.puts("slewtoazimuth", since), 15)


def hang(harness):
    """It takes the command, says that it slews, and does not move."""
    since = harness.wire.last()
    harness.wire.change("dome", turn_deg_per_s=0)
    slip(harness)
    asked_to_turn(harness, since)


def refuse(harness):
    since = harness.wire.last()
    harness.wire.fault("dome", error=0x500, only=["slewtoazimuth"])
    slip(harness)
    asked_to_turn(harness, since)


def run_on(harness):
    """Slewing stays true, and the azimuth runs round and round."""
    since = harness.wire.last()
    harness.wire.change("dome", runs_on=True)
    slip(harness)
    asked_to_turn(harness, since)
    wait("the dome turns", lambda: harness.wire.world()["dome"]["turning"], 5)


def stop_half_way(harness):
    since = harness.wire.last()
    harness.wire.change("dome", turn_deg_per_s=20)
    slip(harness)
    from_deg = azimuth_deg(harness)
    asked_to_turn(harness, since)
    wait("the dome is half way", lambda: abs((azimuth_deg(harness) - from_deg + 180.0) % 360.0 - 180.0) > 20.0, 10, 0.02)
    harness.wire.change("dome", turn_deg_per_s=0)
    if not harness.wire.world()["dome"]["turning"]:
        raise Late("the dome had arrived before it was stopped")


def report_nan(harness):
    harness.wire.fault("dome", nan=True, only=["azimuth", "devicestate"])
    time.sleep(1.5)


def slaved_and_hanging(harness):
    """Its own driver brings it along, and gets nowhere."""
    if not harness.wire.world()["dome"]["slaved"]:
        raise Late("the dome is not slaved before the fault")
    harness.wire.change("dome", turn_deg_per_s=0)
    harness.wire.ask_alpaca("dome", "slaved", Slaved="False")
    slip(harness)
    harness.wire.ask_alpaca("dome", "slaved", Slaved="True")
    wait("the dome tries to turn", lambda: harness.wire.world()["dome"]["turning"], 5)


def then_unsafe(fault, **order):
    def run(harness):
        for word, on in order.items():
            harness.wire.change("dome", **{word: on})
        fault(harness)
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        yield
    return run


case("dome's azimuth hangs, and it is unsafe", "D1 D4", TURNING)(then_unsafe(hang))
case("dome's azimuth refuses, and it is unsafe", "D2 D4", TURNING, short=False)(then_unsafe(refuse))
case("dome turns for ever, and it is unsafe", "D4", TURNING, short=False)(then_unsafe(run_on))
case("dome turns for ever and moves no shutter meanwhile, and it is unsafe", "D4", TURNING)(
    then_unsafe(run_on, shutter_needs_rest=True))
case("dome stops half way, and it is unsafe", "D4", TURNING)(then_unsafe(stop_half_way))
case("dome stops half way and moves no shutter meanwhile, and it is unsafe", "D4", TURNING, short=False)(
    then_unsafe(stop_half_way, shutter_needs_rest=True))
case("dome's azimuth is NaN, and it is unsafe", "D3", TURNING, short=False)(then_unsafe(report_nan))
case("dome that its own driver turns hangs, and it is unsafe", "D1 D4", TURNING, flavour="slave")(
    then_unsafe(slaved_and_hanging))


@case("somebody ends the slaving of a dome that its own driver turns: it is slaved again", "D12", group=OVERTAKEN,
      flavour="slave", watch_s=2.0, short=False)
def let_go(harness):
    harness.mark()
    harness.wire.ask_alpaca("dome", "slaved", Slaved="False")
    wait("the dome is slaved again", lambda: harness.wire.world()["dome"]["slaved"], 15)
    yield


def hidden_s(harness) -> float:
    """Sky time in which a camera exposed behind a part of the wall, by the simulator's own rays."""
    return harness.wire.world()["dome"]["vignetted_s"]


def no_frame_behind_the_wall(harness, watch_s: float):
    since, before_s = harness.wire.last(), hidden_s(harness)
    time.sleep(watch_s)
    begun, lost_s = harness.puts("startexposure", since), hidden_s(harness) - before_s
    if begun or lost_s > 0.0:
        raise Late(f"{len(begun)} exposures began behind the wall, which hid {lost_s:.1f} s of light")


def observes_again(harness):
    """Frames are taken, and of the sky."""
    since = harness.wire.last()
    wait("an exposure begins", lambda: harness.puts("startexposure", since), 40)
    before_s = hidden_s(harness)
    time.sleep(2.0)
    if hidden_s(harness) > before_s:
        raise Late("the slit hides the new exposure")


def overtaken(fault):
    def run(harness):
        since, before_s = harness.wire.last(), hidden_s(harness)
        harness.mark()
        fault(harness)
        wait("the exposure is ended", lambda: harness.puts("abortexposure", since), 8)
        time.sleep(0.5)
        lost_s = hidden_s(harness) - before_s
        if lost_s > 6.0:
            raise Late(f"{lost_s:.1f} s of light were lost before the exposure was ended")
        no_frame_behind_the_wall(harness, 4.0)
        harness.wire.heal()
        observes_again(harness)
        yield
    return run


case("dome hangs under a long exposure: it is ended, and taken again when the dome turns", "D1 D3", group=OVERTAKEN,
     **LONG)(overtaken(hang))
case("dome refuses to turn under a long exposure", "D2 D3", group=OVERTAKEN, short=False, **LONG)(overtaken(refuse))


@case("dome slips at the very end of a long exposure: it is let end", "D3", group=OVERTAKEN, short=False, **LONG)
def nearly_done(harness):
    since = harness.wire.last()
    began = arrived_s(harness.exposes())
    time.sleep(max(0.0, began + 0.94 * harness.exposure_s - time.time()))
    harness.wire.change("dome", turn_deg_per_s=0)
    slip(harness)
    harness.mark()
    time.sleep(1.5)
    no_frame_behind_the_wall(harness, 4.0)
    if harness.puts("abortexposure", since):
        raise Late("an exposure that was nearly done was thrown away")
    harness.wire.heal()
    observes_again(harness)
    yield


@case("dome turns for ever under a safe sky: it is stopped, and turns again when it can", "D3 D4", group=OVERTAKEN,
      short=False, **LONG)
def stopped(harness):
    since = harness.wire.last()
    harness.mark()
    run_on(harness)
    wait("the dome is stopped", lambda: [put for put in harness.puts("abortslew", since) if put["device"] == "dome"], 40)
    harness.wire.heal()
    observes_again(harness)
    yield
