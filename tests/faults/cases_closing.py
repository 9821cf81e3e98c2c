"""Closing against a status that lies, and against anybody on the bus who would hinder it or end the night."""

import json
import threading
import time
import uuid

from case import DOME_FAULT, ISSAFE, SILENCE, case
from cases_bus import DOME, GROUP, GUARD, MOUNT, PERMIT
from rig import PREFIX, Late, wait

LEASE = f"{PREFIX}/observatory/lease/state"
LARGEST = 2 ** 64 - 1


def reopened_blind(rig, **stuck):
    """Closes the dome, lets its status stick, and has the night open it again; true is what the simulator says."""
    since = rig.wire.last()
    rig.wire.change("safety", unsafe=True)
    wait("closed", lambda: rig.puts("closeshutter", since) and rig.wire.open_fraction() == 0.0, 15)
    time.sleep(2.0)
    rig.wire.fault("dome", only=["shutterstatus", "devicestate"], **stuck)
    since = rig.wire.last()
    rig.wire.change("safety", unsafe=False)
    wait("opened, whatever the status says", lambda: rig.puts("openshutter", since)
         and rig.wire.open_fraction() == 1.0, 40)


@case("the status sticks at closed while the dome is opened, and it is unsafe", "D4 D5", DOME_FAULT)
def stuck_at_closed(rig):
    reopened_blind(rig, stale=True)
    rig.mark()
    rig.wire.change("safety", unsafe=True)
    yield


@case("the status sticks at closed while the dome is opened, and the observatory dies", "D4 D5 N1", SILENCE,
      close_within_s=30.0, short=False, members=("closeshutter",))
def stuck_and_dead(rig):
    reopened_blind(rig, stale=True)
    rig.wire.change("safety", unsafe=True)
    rig.kill("observatory")
    rig.mark()
    yield


def closes_although(rig, hinder, within_s: float):
    """Calls `hinder` again and again until the dome is closed."""
    over = threading.Event()

    def hinders():
        while not over.is_set():
            hinder()
            time.sleep(0.05)
    thread = threading.Thread(target=hinders, daemon=True)
    thread.start()
    wait("closed", lambda: rig.wire.open_fraction() == 0.0, within_s)
    over.set()
    thread.join()


@case("everybody stops, turns and parks the dome while it must close", "B3 D4", ISSAFE)
def hindered(rig):
    ear = rig.fresh_ear()

    def hinder():
        for deed in ("abort", "park", {"slew_to_azimuth": {"azimuth_deg": 200.0}}):
            token = ear.newest[GUARD]["token"]
            command = {"id": str(uuid.uuid4()), "from": "observatory/alpha/main", "do": deed}
            if deed != "park":
                command["token"] = token
            ear.ask(f"{DOME}/command", command, 1.0)
    rig.mark()
    rig.wire.change("safety", unsafe=True)
    # a stop that came before anybody knew of the danger is none that this is about
    wait("closing", lambda: rig.wire.open_fraction() < 1.0, 10, 0.02)
    closes_although(rig, hinder, 10)
    yield


@case("one word each with the largest token: permit, lease, guard", "B3 N13", group=GROUP, watch_s=14.0, exposes=True)
def largest_token(rig):
    ear = rig.fresh_ear()
    rig.exposes(60)
    permit = ear.wait_for("a permit", lambda newest: newest.get(PERMIT), 10)
    lease = ear.wait_for("the lease", lambda newest: newest.get(LEASE), 10)
    rig.mark()
    guard = dict(ear.newest[GUARD])
    for key, said, more in [
        (PERMIT, permit, {"guard_number": guard["number"], "verdict": "unsafe"}),
        (PERMIT, permit, {"guard_number": guard["number"], "verdict": "unsafe", "boot_id": str(uuid.uuid4())}),
        (LEASE, lease, {"holder": "observatory/alpha/other"}),
        (GUARD, guard, {"boot_id": str(uuid.uuid4()), "granted": [{"telescope": "alpha", "token": LARGEST}]}),
    ]:
        word = {**said, "seq": LARGEST, "token": LARGEST, **more}
        ear.session.put(key, json.dumps(word).encode(), encoding="application/json")
    command = {"id": str(uuid.uuid4()), "from": "observatory/alpha/other", "token": LARGEST, "do": "open_shutter"}
    if [reply["answer"] for reply in ear.ask(f"{DOME}/command", command)] != ["refusal"]:
        raise Late("a command with the largest token was taken")
    yield


@case("after the largest token the observatory is restarted: it is granted the next lease", "B3 N13 N1", group=GROUP,
      may_close=True, watch_s=1.0)
def largest_token_and_restart(rig):
    ear = rig.fresh_ear()
    token = ear.newest[GUARD]["token"]
    lease = ear.wait_for("the lease", lambda newest: newest.get(LEASE), 10)
    word = {**lease, "token": LARGEST, "seq": LARGEST, "holder": "observatory/alpha/other"}
    ear.session.put(LEASE, json.dumps(word).encode(), encoding="application/json")
    time.sleep(1.0)
    rig.restart("observatory")
    rig.mark()
    newest = ear.wait_for("the next lease", lambda newest: newest[GUARD]["token"] > token and newest[GUARD]["token"], 40)
    if newest > token + 3:
        raise Late(f"the lease after {token} is {newest}")
    rig.exposes(60)
    yield


@case("somebody says the state of each node with an older and with a newer life: none ends", "B3 N11", group=GROUP, watch_s=8.0)
def other_lives(rig):
    ear = rig.fresh_ear()
    rig.exposes(60)
    keys = [f"{PREFIX}/node/{role}/{name}/state" for role, name in
            (("observatory", "main"), ("device", "dome"), ("device", "hands"), ("archive", "main"))]
    states = [(key, ear.wait_for(key, lambda newest, key=key: newest.get(key), 15)) for key in keys]
    living = [name for name, process in rig.processes.items() if process.poll() is None]
    rig.mark()
    for key, state in states:
        for life in ("00000000-0000-7000-8000-000000000000", "ffffffff-ffff-7fff-bfff-ffffffffffff"):
            word = {**state, "boot_id": life, "seq": LARGEST}
            ear.session.put(key, json.dumps(word).encode(), encoding="application/json")
    time.sleep(3.0)
    ended = [name for name in living if rig.processes[name].poll() is not None]
    if ended:
        raise Late(f"ended by a word on the bus: {ended}")
    yield


@case("everybody stops the mount while the roof waits for its park, and it is unsafe", "B3 D7", ISSAFE, flavour="roof",
      members=("park", "abortslew", "tracking"), close_within_s=14.0)
def hindered_park(rig):
    ear = rig.fresh_ear()

    def hinder():
        ear.ask(f"{MOUNT}/command", {"id": str(uuid.uuid4()), "from": "web/ops", "do": "abort"}, 1.0)
    rig.mark()
    rig.wire.change("safety", unsafe=True)
    closes_although(rig, hinder, 30)
    yield


@case("somebody opens the shutter while it closes for an unsafe sky", "B3 D4", ISSAFE)
def opened_while_it_closes(rig):
    since = rig.wire.last()
    rig.wire.change("safety", unsafe=True)
    wait("the shutter closes", lambda: rig.puts("closeshutter", since) and rig.wire.open_fraction() < 0.7, 10, 0.02)
    rig.wire.ask_alpaca("dome", "openshutter")
    rig.mark()
    yield
