"""A part of a process that hangs while the rest lives, processes that get no time, that start again and again, or twice."""

import json
import signal
import threading
import time

from case import DOME_NODE, GUARD_PROCESS, HANDS, ISSAFE, SILENCE, UNCOMMANDED, Bound, case, watchdog
from freeze import Frozen
from harness import PREFIX, WATCHDOG_S, Late, arrived_s, free_port, wait

# from the beginning of an exposure until it should have been read out
EXPOSED_S = 5.0
# the main thread and the workers of tokio; zenoh's threads have other names and keep the session alive
LOOPS = ("starmesh", "tokio-rt-worker")
# a second device node is up by then
TWICE_S = 4.0
TWICE = Bound(f"two device nodes for one device, and unsafe {TWICE_S:.0f} s later", TWICE_S + 3.0)
RESUMED = Bound("all nodes suspended for 15 s and resumed", 3.0)
RESTARTED = "a node is restarted at once: nothing need close"


def deadlocked(node: str, arm: bool = False):
    def run(harness):
        if arm:
            harness.wire.change("watchdog", limit_s=WATCHDOG_S)
        harness.mark()
        frozen = Frozen(harness.loops(node), *LOOPS)
        try:
            yield
        finally:
            frozen.thaw()
    return run


case("observatory's loops deadlock while its session lives", "N2 N3", SILENCE)(deadlocked("observatory"))
case("other device node's loops deadlock while its session lives", "N5 S2", HANDS)(deadlocked("hands"))
case("loops of the dome's device node deadlock while its session lives: its hardware closes", "N5",
     watchdog(WATCHDOG_S), members=())(deadlocked("dome", arm=True))
case("loops of the dome's device node deadlock while its session lives: the guard process closes", "N5",
     GUARD_PROCESS)(deadlocked("dome"))


@case("the runner waits for a camera that never answers, then it is unsafe", "N3 D10", ISSAFE)
def stuck_runner(harness):
    harness.wire.fault("camera", stale=True, only=["imageready", "camerastate", "devicestate"])
    time.sleep(EXPOSED_S)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


@case("observatory gets a twentieth of a processor, then it is unsafe", "N11", SILENCE, watch_s=20.0)
def starved(harness):
    pid_stops = 0
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    until = time.monotonic() + 16.0
    while time.monotonic() < until and harness.wire.open_fraction() > 0.0:
        harness.signal(signal.SIGSTOP, "observatory")
        time.sleep(0.19)
        harness.signal(signal.SIGCONT, "observatory")
        time.sleep(0.01)
        pid_stops += 1
    if pid_stops < 3:
        raise Late("the dome was closed before anything was slow")
    yield


@case("all nodes suspended for 15 s, as with their machine, and resumed", "N18 N2", RESUMED)
def suspended(harness):
    nodes = ["dome", "hands", "observatory", "archive", "web"]
    harness.signal(signal.SIGSTOP, *nodes)
    time.sleep(15.0)
    harness.mark()
    harness.signal(signal.SIGCONT, *nodes)
    yield


def crash_loop(run_s: float, pause_s: float):
    """It starts and is killed for ever; it is judged meanwhile. No life is long enough for a permit to run out in it."""
    def run(harness):
        healed = threading.Event()

        def loop():
            while not healed.wait(pause_s):
                harness.start("dome")
                healed.wait(run_s)
                harness.processes["dome"].kill()
                harness.processes["dome"].wait()
        harness.kill("observatory", "dome")
        looping = threading.Thread(target=loop, daemon=True)
        looping.start()
        try:
            yield
        finally:
            healed.set()
            looping.join(30.0)
    return run


# the pauses of systemd and of `starmesh up` before a device node
for run_s, pause_s in [(8.0, 2.0), (8.0, 0.2), (3.0, 5.0)]:
    case(f"dome's device node killed every {run_s:.0f} s, started again after {pause_s:g} s, and nobody permits", "N15 N4",
         DOME_NODE)(crash_loop(run_s, pause_s))


@case("under `starmesh up`: dome's device node killed again and again", "N15 N4", group=RESTARTED, may_close=True,
      watch_s=12.0, flavour="up")
def up_crash_loop(harness):
    pauses = []
    for _ in range(4):
        harness.kill_nodes("node device --id dome")
        killed = time.monotonic()
        wait("the dome's device node is started again", lambda: harness.pids("node device --id dome"), 20)
        pauses.append(time.monotonic() - killed)
    if max(pauses) > 6.0:
        raise Late(f"restarted after {max(pauses):.1f} s, at most 5 s are allowed")
    yield


@case("all nodes are killed at once and started again: nothing closes", "N1 N4", group=RESTARTED, watch_s=20.0)
def all_restarted(harness):
    """What the observatory node wrote says that the sky was good until then: no dwell starts anew."""
    nodes = ["dome", "hands", "observatory", "archive", "web"]
    harness.kill(*nodes)
    for node in nodes:
        harness.start(node)
    yield


def twice(node: str):
    """A second device node for the same devices, as after a mistaken start on another host."""
    def run(harness):
        subscriber = harness.fresh_subscriber()
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        harness.mark()  # what the other says while it connects may close already
        # a file of its own, as on another host: a second guard process of one file waits for the first one's lock
        other = harness.folder / "other.toml"
        other.write_text(harness.configuration.read_text())
        command = [str(other) if node == "dome" and word.endswith("observatory.toml") else word
                   for word in harness.command(node, node, endpoint)]
        harness.spawn("twin", command + ["--connect", harness.endpoint("observatory")])
        time.sleep(TWICE_S)
        harness.wire.change("safety", unsafe=True)
        yield
        # the younger of the two leaves, maybe before it has said what would make it a second writer
        subscriber.wait_for("an alert about the other node", lambda newest: any(
            word in json.dumps(payload) for key, payload in newest.items() if "alert" in key
            for word in ("second-writer", '"twin')), 30)
        harness.end("twin")
    return run


case("two device nodes for one dome, then it is unsafe", "N14", TWICE)(twice("dome"))
case("two device nodes for the other devices, then it is unsafe", "N14", TWICE)(twice("hands"))


def mute(kind: str, *members: str):
    """Commands are obeyed, and their answers lost: nothing may be done twice for that, and nothing be left undone."""
    def run(harness):
        harness.wire.fault(kind, mute=True, only=list(members))
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        yield
    return run


case("dome closes, and the answer is lost", "D11 D4", UNCOMMANDED, short=False)(mute("dome", "closeshutter"))


@case("an exposure begins, and the answer is lost: it is not begun twice", "D11", group="mount or dome at fault for a while, sky safe",
      watch_s=2.0)
def exposure_mute(harness):
    since = harness.wire.last()
    harness.wire.fault("camera", mute=True, only=["startexposure"])
    wait("three exposures", lambda: len(harness.puts("startexposure", since)) >= 3, 40)
    harness.wire.fault("camera")
    starts = [arrived_s(put) for put in harness.puts("startexposure", since)]
    gaps = [later - earlier for earlier, later in zip(starts, starts[1:])]
    if min(gaps) < 3.0:
        raise Late(f"an exposure of 3 s was begun again after {min(gaps):.2f} s")
    harness.mark()
    yield


@case("a peer of another version speaks on the bus, then it is unsafe", "N16 B1", ISSAFE)
def versions(harness):
    subscriber = harness.fresh_subscriber()
    state = f"{PREFIX}/device/safetymonitor/monitor/state"
    received = subscriber.wait_for("the monitor", lambda newest: newest.get(state), 10)
    # the next major version beside ours, ours with fields of tomorrow, and words that are not known yet
    foreign = {**received, "boot_id": "ffffffff-ffff-7fff-bfff-ffffffffffff", "seq": 1}
    for key, payload in [(state.replace("/v1/", "/v2/"), {**foreign, "fields": {"is_safe": "yes"}}),
                         (f"{PREFIX}/device/safetymonitor/tomorrow/state", {**foreign, "fields": {"is_safe": True, "mood": 7}}),
                         (f"{PREFIX}/observatory/permit/dome", {**foreign, "verdict": "probably", "token": "x"}),
                         (f"{PREFIX}/device/telescope/mount/command", {"id": "x", "from": "y", "do": {"dance": {}}})]:
        for _ in range(20):
            subscriber.session.put(key, json.dumps(payload).encode())
    time.sleep(2.0)
    if harness.wire.open_fraction() != 1.0:
        raise Late("words of another version closed the dome")
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield
