"""Processes killed, stopped, ended and started again, in each phase of a night."""

import signal
import time

from case import DOME_NODE, END_CLOSES, HANDS, SILENCE, case, watchdog
from harness import WATCHDOG_S, Late, free_port, wait

NOTHING = "archive or web dead: nothing closes"
BRIEF = "a node is restarted at once: nothing need close"
PHASES = ["opening", "slewing", "exposing", "downloading", "closing"]


def killed(*nodes):
    def run(harness):
        harness.kill(*nodes)
        yield
    return run


def stopped(*nodes):
    def run(harness):
        harness.mark()
        harness.signal(signal.SIGSTOP, *nodes)
        yield
        harness.signal(signal.SIGCONT, *nodes)
        # what it had queued is old: a permit of before must not open anything; the guard's numbers see to it
        time.sleep(0.5)
    return run


def ended(*nodes):
    def run(harness):
        harness.term(*nodes)
        yield
    return run


def signalled(*nodes):
    """An order to end, and what comes of it before the process has ended counts."""
    def run(harness):
        harness.mark()
        harness.signal(signal.SIGTERM, *nodes)
        yield
        for node in nodes:
            harness.processes[node].wait(timeout=30)
    return run


def restarted(how, *nodes):
    """The supervisor is quick: within 2 s, as `starmesh up` and systemd are."""
    def run(harness):
        how(*nodes)(harness).__next__()
        time.sleep(2.0)
        harness.restart(*nodes)
        yield
    return run


for phase in PHASES:
    case(f"observatory killed while {phase}", "N1", SILENCE, phase=phase)(killed("observatory"))
for phase in ["exposing", "slewing"]:
    case(f"observatory stopped while {phase}", "N2", SILENCE, phase=phase)(stopped("observatory"))
case("observatory ended by SIGTERM", "N1", END_CLOSES)(signalled("observatory"))
case("dome's device node ended by SIGTERM", "N4", END_CLOSES)(signalled("dome"))
for phase in ["exposing", "downloading"]:
    case(f"other device node killed while {phase}", "S2 S3 N4", HANDS, phase=phase)(killed("hands"))
case("other device node stopped", "S2 N5", HANDS)(stopped("hands"))
case("other device node ended by SIGTERM", "S2 N4", HANDS)(ended("hands"))
case("observatory and other device node killed", "N1 N19", SILENCE)(killed("observatory", "hands"))
case("observatory and archive killed", "N1 N9", SILENCE)(killed("observatory", "archive"))
case("observatory and web stopped", "N2 N10", SILENCE, short=False)(stopped("observatory", "web"))

for how, word in [(killed, "killed"), (stopped, "stopped"), (ended, "ended by SIGTERM")]:
    for node in ["archive", "web"]:
        case(f"{node} {word}", "S10 N9 N10", group=NOTHING)(how(node))
for phase in PHASES:
    case(f"archive and web killed while {phase}", "S10 N9 N10", group=NOTHING, phase=phase,
         short=phase in ("exposing", "downloading"), may_close=phase == "closing")(killed("archive", "web"))

for phase in ["exposing", "slewing"]:
    case(f"observatory killed and restarted at once while {phase}", "N1 N19", group=BRIEF, phase=phase,
         may_close=True, watch_s=14.0)(restarted(killed, "observatory"))
for phase in ["exposing", "opening", "closing", "slewing"]:
    case(f"dome's device node killed and restarted at once while {phase}", "N4 N19", group=BRIEF, phase=phase,
         may_close=True, watch_s=14.0, short=phase in ("exposing", "opening"))(restarted(killed, "dome"))
case("dome's device node ended by SIGTERM and restarted", "N4", group=BRIEF, may_close=True,
     watch_s=14.0)(restarted(ended, "dome"))
case("other device node killed and restarted at once", "N4", group=BRIEF, may_close=True,
     watch_s=10.0)(restarted(killed, "hands"))


@case("observatory killed for good: the mount stops by itself after 60 s", "N12 N1", SILENCE)
def mount_stops(harness):
    harness.kill("observatory")
    yield
    wait("the mount stops tracking without a commander", lambda: not harness.wire.world()["telescope"]["tracking"],
         max(0.0, harness.t0 + 60.0 + 10.0 + 5.0 - time.time()), 0.2)  # 60 s from the end of the last permit


@case("observatory and dome's device node killed; the latter restarted after 5 s", "N4 N19", DOME_NODE)
def both_dead(harness):
    harness.kill("observatory", "dome")
    time.sleep(5.0)
    harness.restart("dome")
    yield


@case("all nodes killed; the dome's restarted after 5 s", "N19", DOME_NODE)
def all_dead(harness):
    harness.kill("observatory", "dome", "hands", "archive", "web")
    time.sleep(5.0)
    harness.restart("dome")
    yield


@case("dome's device node stopped: its hardware closes", "N5", watchdog(WATCHDOG_S), members=())
def dome_stopped(harness):
    harness.wire.change("watchdog", limit_s=WATCHDOG_S)
    harness.mark()
    harness.signal(signal.SIGSTOP, "dome")
    yield
    harness.signal(signal.SIGCONT, "dome")


@case("dome's host dead: its hardware closes", "N4", watchdog(WATCHDOG_S), members=())
def dome_host_dead(harness):
    harness.wire.change("watchdog", limit_s=WATCHDOG_S)
    harness.kill("dome")
    yield


@case("a healthy night with a hardware watchdog: it is fed while the permit lives", "N5",
      group="hardware watchdog fed by a living permit", watch_s=2.0)
def watchdog_fed(harness):
    before = harness.wire.world()["dome"]["watchdog_closings"]
    harness.wire.change("watchdog", limit_s=WATCHDOG_S)
    time.sleep(WATCHDOG_S + 4.0)
    barked = harness.wire.world()["dome"]["watchdog_closings"] - before
    if barked:
        raise Late(f"the hardware closed a permitted dome after {WATCHDOG_S} s without a feeding")
    yield


@case("a second observatory takes over before the permit runs out", "N13", group=BRIEF, watch_s=10.0)
def standby(harness):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    harness.spawn("standby", harness.command("observatory", "second", endpoint) + ["--connect", harness.endpoint("observatory")])
    time.sleep(10.0)  # it must hear everything and fill its dwell before it can be of use
    harness.kill("observatory")
    yield
    # the first comes back and waits; then the second goes
    harness.restart("observatory")
    time.sleep(6.0)
    harness.end("standby")
    wait("the standby is gone", lambda: harness.processes["standby"].poll() is not None, 10)
    since = harness.wire.last()
    wait("the first commands again: it exposes", lambda: harness.puts("startexposure", since), 60)
