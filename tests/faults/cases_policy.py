"""Roofs that wait for the mount, and the real supervisor."""

import contextlib
import os
import signal

from case import END_CLOSES, SILENCE, WAITING_ROOF, Bound, case
from harness import NODES, descendants

UP, ROOF, ONLY = {"flavour": "up"}, {"flavour": "roof"}, {"flavour": "only"}
# the monitor's age, then the guard process gives the commander 10 s to park the mount
UNPARKED = Bound("roof waits for the park, and the mount's node is dead: first stop or park", 7.0 + 12.0)
STOPS = ("park", "abortslew", "tracking")


@case("roof that waits for the park: it is unsafe", "S1 D7", WAITING_ROOF, members=STOPS, **ROOF)
def waiting(harness):
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


# 6 s of waiting, then it closes whatever the mount says
@case("roof that waits 6 s for the park: it is unsafe and the mount hangs", "D7 D1", WAITING_ROOF, members=STOPS,
      close_within_s=14.0, **ROOF)
def waiting_hang(harness):
    harness.wire.fault("telescope", hang=True)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


@case("roof that waits 6 s for the park: the observatory dies", "D7 N1", SILENCE, members=STOPS + ("closeshutter",),
      close_within_s=14.0, **ROOF)
def waiting_dead(harness):
    harness.kill("observatory")
    yield


@case("under `starmesh up`: observatory and dome's device node killed", "N1 N4",
      group="a node is restarted at once: nothing need close", may_close=True, watch_s=16.0, **UP)
def up_restarts(harness):
    harness.kill_nodes("node observatory", "node device --id dome")
    yield


@case("`starmesh up` itself killed: the device nodes outlive it and close", "N1 N4", SILENCE, **UP)
def up_killed(harness):
    harness.kill_up()
    yield


@case("under `starmesh up`: archive and web killed", "N9 N10 S10", group="archive or web dead: nothing closes",
      short=False, **UP)
def up_others(harness):
    harness.kill_nodes("node archive", "node web")
    yield


@case("roof that closes over a parked mount only: the mount's device node dies for good", "D7 N5", UNPARKED, members=STOPS,
      close_within_s=20.0, **ONLY)
def mount_node_gone(harness):
    harness.kill("hands")
    yield


@case("roof that closes over a parked mount only: SIGTERM to every process at once", "D7 N1", END_CLOSES, members=STOPS,
      close_within_s=20.0, goes_on=False, leave=True, **ONLY)
def all_ended_at_once(harness):
    everybody = {node: [harness.processes[node].pid, *descendants(harness.processes[node].pid)] for node in NODES}
    harness.mark()
    for pid in [pid for pids in everybody.values() for pid in pids]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    yield
