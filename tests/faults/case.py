"""What one injection is, and how it is judged."""

import dataclasses
import time
import traceback

from harness import SHUTTER_S, Late, Harness, arrived_s, wait
from hazards import HAZARDS


@dataclasses.dataclass(frozen=True)
class Bound:
    """Seconds from the injection to the first request that closes; `p99_s`: 99 of 100 come within it, where one is promised."""

    group: str
    max_s: float
    p99_s: float | None = None


# the weather is polled each second here
ISSAFE = Bound("IsSafe says false", 3.0, 1.5)
WEATHER = Bound("weather beyond a limit", 3.0, 1.5)
MONITOR_SILENT = Bound("safety monitor silent or nonsense (allowed age 5 s)", 7.0)
WEATHER_SILENT = Bound("weather silent or nonsense (allowed age 6 s)", 8.0)
SILENCE = Bound("observatory, link or permit silent", 12.0)
HANDS = Bound("other device node dead (monitor's age 5 s)", 7.0)
MOUNT = Bound("mount's server at fault, and unsafe", 12.0)
DOME_FAULT = Bound("dome at fault, and unsafe", 3.0, 1.5)
DOME_NODE = Bound("dome's device node killed, nobody permits", 20.0)
GUARD_PROCESS = Bound("dome's device node gone, its guard process alive", 13.0)
END_CLOSES = Bound("orderly end of a node at an open dome", 3.0)
MACHINE = Bound("clock, disk, files, and unsafe", 3.0)
SUN = Bound("Sun above its limit", 10.0)
UNCOMMANDED = Bound("opened by a stranger", 3.0)
WAITING_ROOF = Bound("IsSafe false, roof waits for the mount: first stop or park", 3.0, 1.5)


def watchdog(limit_s: float) -> Bound:
    return Bound(f"dome's device node stopped: hardware watchdog ({limit_s:.0f} s here)", limit_s + 2.0)


@dataclasses.dataclass
class Case:
    """`run(harness)` is a generator: it breaks one thing, yields, and heals it.

    `bound` None: nothing need close, and the night must go on; such a case may still close (`may_close`).
    `phase`: what the night does when the thing breaks. `flavour`: which configuration the telescope has (flavours.py).
    `members`: the requests that count as closing. `close_within_s`: the shutter is shut so long after the first of them.
    `watch_s`: how long it is watched that nothing closes. `goes_on`: frames are taken again after it is healed.
    `exposes`: an exposure begins while the fault is there, if nothing closes. `takes_frames_first`: `run` waits for frames before it breaks its thing, so that the
    camera must be whole. `short`: part of the short form. `leave`: the telescope is made anew afterwards.
    """

    name: str
    group: str
    hazards: tuple[str, ...]
    run: object
    bound: Bound | None
    phase: str = "exposing"
    flavour: str = "plain"
    may_close: bool = False
    goes_on: bool = True
    members: tuple[str, ...] = ("closeshutter",)
    close_within_s: float = 30.0
    watch_s: float = 9.0
    short: bool = True
    leave: bool = False
    exposes: bool = True
    takes_frames_first: bool = False


CASES: list[Case] = []


def case(name: str, hazards: str, bound: Bound | None = None, group: str = "", **more):
    """Registers a generator as a case; `hazards` are words of hazards.py with a blank between them."""
    codes = tuple(hazards.split())
    assert all(code in HAZARDS for code in codes), f"{name}: hazards.py knows not all of {hazards}"

    def register(run):
        CASES.append(Case(name, group or (bound.group if bound else ""), codes, run, bound, **more))
        return run
    return register


@dataclasses.dataclass
class Result:
    """How one injection ended."""

    case: Case
    harness: str
    took_s: float | None = None
    closed: bool = False
    went_on: bool | None = None
    lost_s: float | None = None
    why: str = ""
    words: str = ""
    at: float = dataclasses.field(default_factory=time.time)

    @property
    def passed(self) -> bool:
        return not self.why


def inject(case: Case, harness: Harness, allowance_s: float) -> Result:
    """One injection from a night at work to a night at work."""
    result = Result(case, harness.name)
    scenario = None
    try:
        harness.phase(case.phase)
        since = harness.wire.last()
        harness.mark()
        scenario = case.run(harness)
        next(scenario)
        if case.bound:
            judge_closing(case, harness, since, result, allowance_s)
        else:
            judge_staying(case, harness, since, result)
    except Late as late:
        result.why = str(late)
    except Exception:
        result.why = "the case itself failed: " + traceback.format_exc(limit=-2)
    if result.why:
        result.words = harness.last_words()
    try:
        for _ in scenario or ():
            pass
        harness.heal()
        healed = time.time()
        if case.goes_on:
            harness.exposes()
            result.went_on = True
            result.lost_s = time.time() - healed
            harness.everybody_is_met()
    except Exception as error:
        result.went_on = False
        if not result.why:
            result.why = f"afterwards: {error}"
            result.words = harness.last_words()
    return result


def judge_closing(case: Case, harness: Harness, since: int, result: Result, allowance_s: float):
    bound = case.bound
    if case.phase == "closing":
        # it is on its way: no request is needed, and none may turn it back
        wait("the shutter closes", lambda: harness.wire.open_fraction() == 0.0, bound.max_s + 4 * SHUTTER_S)
        result.took_s = 0.0
    elif case.members:
        def closing_requests():
            puts = harness.wire.puts(since)
            return [put for put in puts if put["member"] in case.members and arrived_s(put) >= harness.t0 - 0.02]
        try:
            first = wait("the first request that closes", closing_requests, bound.max_s + 30.0 - (time.time() - harness.t0))[0]
        except Late as late:
            raise Late(f"{late}{closed_before(harness)}") from late
        result.took_s = arrived_s(first) - harness.t0
    else:
        wait("the hardware closes", lambda: harness.wire.open_fraction() < 1.0, bound.max_s + 30.0, 0.02)
        result.took_s = time.time() - harness.t0
    wait("the shutter is closed in truth", lambda: harness.wire.open_fraction() == 0.0,
         max(case.close_within_s, 4 * SHUTTER_S))
    # closed is closed: nothing opens it while the fault stands
    time.sleep(0.6)
    if harness.wire.open_fraction() != 0.0:
        raise Late("it opened again while the fault stood")
    result.closed = True
    if result.took_s > bound.max_s + allowance_s:
        result.why = f"first closing request after {result.took_s:.2f} s, bound {bound.max_s} s + {allowance_s} s"


def closed_before(harness: Harness) -> str:
    """A dome that closed before the fault was not open to be closed: that is a finding of its own, and says so."""
    before = [put for put in harness.puts("closeshutter", 0) if arrived_s(put) < harness.t0 - 0.02]
    if harness.wire.open_fraction() > 0.0 or not before:
        return ""
    return f"; it is closed, and was asked to {harness.t0 - arrived_s(before[-1]):.1f} s before the fault"


def judge_staying(case: Case, harness: Harness, since: int, result: Result):
    until = time.monotonic() + case.watch_s
    while time.monotonic() < until:
        closing = [put for put in harness.puts("closeshutter", since) if arrived_s(put) >= harness.t0]
        result.closed |= bool(closing)
        if closing and not case.may_close:
            raise Late(f"closed {arrived_s(closing[0]) - harness.t0:.1f} s after a fault that need not close")
        time.sleep(0.2)
    if not case.may_close:
        if harness.wire.open_fraction() != 1.0 and case.phase not in ("opening", "closing"):
            raise Late("the dome is not open after a fault that need not close")
        # and the night went on while the fault stood
        if case.exposes:
            wait("an exposure begins while the fault stands", lambda: [
                put for put in harness.puts("startexposure", since) if arrived_s(put) > harness.t0], 15.0)
