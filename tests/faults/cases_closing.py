"""Closing against a status that lies, and against anybody on the bus who would hinder it or end the night."""

import json
import threading
import time
import uuid

from case import DOME_FAULT, ISSAFE, SILENCE, case
from cases_bus import DOME, GROUP, GUARD, MOUNT, PERMIT
from harness import PREFIX, Late, wait

LEASE = f"{PREFIX}/observatory/lease/state"
LARGEST = 2 ** 64 - 1


def reopened_blind(harness, **stuck):
    """Closes the dome, lets its status stick, and has the night open it again; true is what the simulator says."""
    since = harness.wire.last()
    harness.wire.change("safety", unsafe=True)
    wait("closed", lambda: harness.puts("closeshutter", since) and harness.wire.open_fraction() == 0.0, 15)
    time.sleep(2.0)
    harness.wire.fault("dome", only=["shutterstatus", "devicestate"], **stuck)
    since = harness.wire.last()
    harness.wire.change("safety", unsafe=False)
    wait("opened, whatever the status says", lambda: harness.puts("openshutter", since)
         and harness.wire.open_fraction() == 1.0, 40)


@case("the status sticks at closed while the dome is opened, and it is unsafe", "D4 D5", DOME_FAULT)
def stuck_at_closed(harness):
    reopened_blind(harness, stale=True)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


@case("the status sticks at closed while the dome is opened, and the observatory dies", "D4 D5 N1", SILENCE,
      close_within_s=30.0, short=False, members=("closeshutter",))
def stuck_and_dead(harness):
    reopened_blind(harness, stale=True)
    harness.wire.change("safety", unsafe=True)
    harness.kill("observatory")
    harness.mark()
    yield


def closes_although(harness, hinder, within_s: float):
    """Calls `hinder` again and again until the dome is closed."""
    over = threading.Event()

    def hinders():
        while not over.is_set():
            hinder()
            time.sleep(0.05)
    thread = threading.Thread(target=hinders, daemon=True)
    thread.start()
    wait("closed", lambda: harness.wire.open_fraction() == 0.0, within_s)
    over.set()
    thread.join()


@case("everybody stops, turns and parks the dome while it must close", "B3 D4", ISSAFE)
def hindered(harness):
    subscriber = harness.fresh_subscriber()

    def hinder():
        for request in ("abort", "park", {"slew_to_azimuth": {"azimuth_deg": 200.0}}):
            token = subscriber.newest[GUARD]["token"]
            command = {"id": str(uuid.uuid4()), "from": "observatory/alpha/main", "do": request}
            if request != "park":
                command["token"] = token
            subscriber.ask(f"{DOME}/command", command, 1.0)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    # a stop that came before anybody knew of the danger is none that this is about
    wait("closing", lambda: harness.wire.open_fraction() < 1.0, 10, 0.02)
    closes_although(harness, hinder, 10)
    yield


@case("one word each with the largest token: permit, lease, guard", "B3 N13", group=GROUP, watch_s=14.0, exposes=True)
def largest_token(harness):
    subscriber = harness.fresh_subscriber()
    harness.exposes()
    permit = subscriber.wait_for("a permit", lambda newest: newest.get(PERMIT), 10)
    lease = subscriber.wait_for("the lease", lambda newest: newest.get(LEASE), 10)
    harness.mark()
    guard = dict(subscriber.newest[GUARD])
    for key, payload, more in [
        (PERMIT, permit, {"guard_number": guard["number"], "verdict": "unsafe"}),
        (PERMIT, permit, {"guard_number": guard["number"], "verdict": "unsafe", "boot_id": str(uuid.uuid4())}),
        (LEASE, lease, {"holder": "observatory/alpha/other"}),
        (GUARD, guard, {"boot_id": str(uuid.uuid4()), "granted": [{"telescope": "alpha", "token": LARGEST}]}),
    ]:
        word = {**payload, "seq": LARGEST, "token": LARGEST, **more}
        subscriber.session.put(key, json.dumps(word).encode(), encoding="application/json")
    command = {"id": str(uuid.uuid4()), "from": "observatory/alpha/other", "token": LARGEST, "do": "open_shutter"}
    if [reply["answer"] for reply in subscriber.ask(f"{DOME}/command", command)] != ["refusal"]:
        raise Late("a command with the largest token was taken")
    yield


@case("after the largest token the observatory is restarted: it is granted the next lease", "B3 N13 N1", group=GROUP,
      may_close=True, watch_s=1.0)
def largest_token_and_restart(harness):
    subscriber = harness.fresh_subscriber()
    token = subscriber.newest[GUARD]["token"]
    lease = subscriber.wait_for("the lease", lambda newest: newest.get(LEASE), 10)
    word = {**lease, "token": LARGEST, "seq": LARGEST, "holder": "observatory/alpha/other"}
    subscriber.session.put(LEASE, json.dumps(word).encode(), encoding="application/json")
    time.sleep(1.0)
    harness.restart("observatory")
    harness.mark()
    newest = subscriber.wait_for("the next lease", lambda newest: newest[GUARD]["token"] > token and newest[GUARD]["token"], 40)
    if newest > token + 3:
        raise Late(f"the lease after {token} is {newest}")
    harness.exposes()
    yield


@case("somebody says the state of each node with an older and with a newer life: none ends", "B3 N11", group=GROUP, watch_s=8.0)
def other_incarnations(harness):
    subscriber = harness.fresh_subscriber()
    harness.exposes()
    keys = [f"{PREFIX}/node/{role}/{name}/state" for role, name in
            (("observatory", "main"), ("device", "dome"), ("device", "hands"), ("archive", "main"))]
    states = [(key, subscriber.wait_for(key, lambda newest, key=key: newest.get(key), 15)) for key in keys]
    living = [name for name, process in harness.processes.items() if process.poll() is None]
    harness.mark()
    for key, state in states:
        for boot_id in ("00000000-0000-7000-8000-000000000000", "ffffffff-ffff-7fff-bfff-ffffffffffff"):
            word = {**state, "boot_id": boot_id, "seq": LARGEST}
            subscriber.session.put(key, json.dumps(word).encode(), encoding="application/json")
    time.sleep(3.0)
    ended = [name for name in living if harness.processes[name].poll() is not None]
    if ended:
        raise Late(f"ended by a word on the bus: {ended}")
    yield


@case("everybody stops the mount while the roof waits for its park, and it is unsafe", "B3 D7", ISSAFE, flavour="roof",
      members=("park", "abortslew", "tracking"), close_within_s=14.0)
def hindered_park(harness):
    subscriber = harness.fresh_subscriber()

    def hinder():
        subscriber.ask(f"{MOUNT}/command", {"id": str(uuid.uuid4()), "from": "web/ops", "do": "abort"}, 1.0)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    closes_although(harness, hinder, 30)
    yield


@case("somebody opens the shutter while it closes for an unsafe sky", "B3 D4", ISSAFE)
def opened_while_it_closes(harness):
    since = harness.wire.last()
    harness.wire.change("safety", unsafe=True)
    wait("the shutter closes", lambda: harness.puts("closeshutter", since) and harness.wire.open_fraction() < 0.7, 10, 0.02)
    harness.wire.ask_alpaca("dome", "openshutter")
    harness.mark()
    yield
