"""A dome whose turning fails: while it must close, which never waits for it, and while frames are taken through its slit."""

import time

from case import Bound, case
from rig import Late, arrived_s, wait

TURNING = Bound("dome's turning at fault, and unsafe", 3.0, 1.5)
OVERTAKEN = "dome's turning at fault for a while, sky safe"
AWAY_DEG = 90.0
# exposures so long that ending one saves time
LONG = {"flavour": "long", "watch_s": 2.0}


def azimuth_deg(rig) -> float:
    return rig.wire.world()["dome"]["azimuth_deg"]


def slip(rig):
    """The dome stands elsewhere all at once, and knows it."""
    rig.wire.ask_alpaca("dome", "synctoazimuth", Azimuth=(azimuth_deg(rig) + AWAY_DEG) % 360.0)


def asked_to_turn(rig, since: int):
    return wait("the dome is asked to turn back", lambda: rig.puts("slewtoazimuth", since), 15)


def hang(rig):
    """It takes the command, says that it slews, and does not move."""
    since = rig.wire.last()
    rig.wire.change("dome", turn_deg_per_s=0)
    slip(rig)
    asked_to_turn(rig, since)


def refuse(rig):
    since = rig.wire.last()
    rig.wire.fault("dome", error=0x500, only=["slewtoazimuth"])
    slip(rig)
    asked_to_turn(rig, since)


def run_on(rig):
    """Slewing stays true, and the azimuth runs round and round."""
    since = rig.wire.last()
    rig.wire.change("dome", runs_on=True)
    slip(rig)
    asked_to_turn(rig, since)
    wait("the dome turns", lambda: rig.wire.world()["dome"]["turning"], 5)


def stop_half_way(rig):
    since = rig.wire.last()
    rig.wire.change("dome", turn_deg_per_s=20)
    slip(rig)
    from_deg = azimuth_deg(rig)
    asked_to_turn(rig, since)
    wait("the dome is half way", lambda: abs((azimuth_deg(rig) - from_deg + 180.0) % 360.0 - 180.0) > 20.0, 10, 0.02)
    rig.wire.change("dome", turn_deg_per_s=0)
    if not rig.wire.world()["dome"]["turning"]:
        raise Late("the dome had arrived before it was stopped")


def say_nan(rig):
    rig.wire.fault("dome", nan=True, only=["azimuth", "devicestate"])
    time.sleep(1.5)


def slaved_and_hanging(rig):
    """Its own driver brings it along, and gets nowhere."""
    if not rig.wire.world()["dome"]["slaved"]:
        raise Late("the dome is not slaved before the fault")
    rig.wire.change("dome", turn_deg_per_s=0)
    rig.wire.ask_alpaca("dome", "slaved", Slaved="False")
    slip(rig)
    rig.wire.ask_alpaca("dome", "slaved", Slaved="True")
    wait("the dome tries to turn", lambda: rig.wire.world()["dome"]["turning"], 5)


def then_unsafe(fault, **order):
    def run(rig):
        for word, on in order.items():
            rig.wire.change("dome", **{word: on})
        fault(rig)
        rig.mark()
        rig.wire.change("safety", unsafe=True)
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
case("dome's azimuth is NaN, and it is unsafe", "D3", TURNING, short=False)(then_unsafe(say_nan))
case("dome that its own driver turns hangs, and it is unsafe", "D1 D4", TURNING, flavour="slave")(
    then_unsafe(slaved_and_hanging))


@case("somebody ends the slaving of a dome that its own driver turns: it is slaved again", "D12", group=OVERTAKEN,
      flavour="slave", watch_s=2.0, short=False)
def let_go(rig):
    rig.mark()
    rig.wire.ask_alpaca("dome", "slaved", Slaved="False")
    wait("the dome is slaved again", lambda: rig.wire.world()["dome"]["slaved"], 15)
    yield


def hidden_s(rig) -> float:
    """Sky time in which a camera exposed behind a part of the wall, by the simulator's own rays."""
    return rig.wire.world()["dome"]["vignetted_s"]


def no_frame_behind_the_wall(rig, watch_s: float):
    since, before_s = rig.wire.last(), hidden_s(rig)
    time.sleep(watch_s)
    begun, lost_s = rig.puts("startexposure", since), hidden_s(rig) - before_s
    if begun or lost_s > 0.0:
        raise Late(f"{len(begun)} exposures began behind the wall, which hid {lost_s:.1f} s of light")


def observes_again(rig):
    """Frames are taken, and of the sky."""
    since = rig.wire.last()
    wait("an exposure begins", lambda: rig.puts("startexposure", since), 40)
    before_s = hidden_s(rig)
    time.sleep(2.0)
    if hidden_s(rig) > before_s:
        raise Late("the slit hides the new exposure")


def overtaken(fault):
    def run(rig):
        since, before_s = rig.wire.last(), hidden_s(rig)
        rig.mark()
        fault(rig)
        wait("the exposure is ended", lambda: rig.puts("abortexposure", since), 8)
        time.sleep(0.5)
        lost_s = hidden_s(rig) - before_s
        if lost_s > 6.0:
            raise Late(f"{lost_s:.1f} s of light were lost before the exposure was ended")
        no_frame_behind_the_wall(rig, 4.0)
        rig.wire.heal()
        observes_again(rig)
        yield
    return run


case("dome hangs under a long exposure: it is ended, and taken again when the dome turns", "D1 D3", group=OVERTAKEN,
     **LONG)(overtaken(hang))
case("dome refuses to turn under a long exposure", "D2 D3", group=OVERTAKEN, short=False, **LONG)(overtaken(refuse))


@case("dome slips at the very end of a long exposure: it is let end", "D3", group=OVERTAKEN, short=False, **LONG)
def nearly_done(rig):
    since = rig.wire.last()
    began = arrived_s(rig.exposes())
    time.sleep(max(0.0, began + 0.94 * rig.exposure_s - time.time()))
    rig.wire.change("dome", turn_deg_per_s=0)
    slip(rig)
    rig.mark()
    time.sleep(1.5)
    no_frame_behind_the_wall(rig, 4.0)
    if rig.puts("abortexposure", since):
        raise Late("an exposure that was nearly done was thrown away")
    rig.wire.heal()
    observes_again(rig)
    yield


@case("dome turns for ever under a safe sky: it is stopped, and turns again when it can", "D3 D4", group=OVERTAKEN,
      short=False, **LONG)
def stopped(rig):
    since = rig.wire.last()
    rig.mark()
    run_on(rig)
    wait("the dome is stopped", lambda: [put for put in rig.puts("abortslew", since) if put["device"] == "dome"], 40)
    rig.wire.heal()
    observes_again(rig)
    yield
