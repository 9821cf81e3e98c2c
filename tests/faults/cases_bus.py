"""The bus: a peer that says what it must not. Nothing it says moves anything, and a valid permit is not disturbed."""

import itertools
import json
import random
import signal
import time
import uuid

from case import ISSAFE, case
from harness import PREFIX, Late, wait

GROUP = "bad motion commands and permits on the bus"
# the soak asks for more
ATTACKS = 200
ATTACK_RUNS = itertools.count()
GUARD, PERMIT = f"{PREFIX}/device/dome/dome/guard", f"{PREFIX}/observatory/permit/dome"
DOME, MOUNT = f"{PREFIX}/device/dome/dome", f"{PREFIX}/device/telescope/mount"
MOTIONS = [
    (DOME, "open_shutter"), (DOME, {"slew_to_azimuth": {"azimuth_deg": 123.0}}), (DOME, {"slave": {"on": True}}),
    (DOME, "resume"), (MOUNT, {"slew": {"ra_deg": 10.0, "dec_deg": -30.0}}), (MOUNT, "unpark"),
    (MOUNT, {"sync": {"ra_deg": 10.0, "dec_deg": -30.0}}),
    (MOUNT, {"pulse_guide": {"direction": "north", "duration_ms": 250}}), (MOUNT, "park"), (MOUNT, {"track": {"on": False}}),
    (f"{PREFIX}/device/focuser/focuser", {"move": {"position": 12345}}),
]
MOVED = {"openshutter", "slewtoazimuth", "slaved", "slewtocoordinatesasync", "slewtocoordinates", "unpark", "synctocoordinates",
         "pulseguide", "park", "move", "abortslew", "tracking", "closeshutter"}
MALFORMED = [b"", b"{", b"null", b"[]", b"\xff\xfe", b'{"id": 7}', b'{"id": "x", "from": "y", "do": "fly"}',
             b'{"id": "x", "from": "y", "token": -1, "do": "open_shutter"}', b'{"id": "x", "from": "y", "token": "9", "do": "open_shutter"}',
             b'{"id": "x", "from": "y", "token": 1e999, "do": "open_shutter"}', b"[" * 2000, b'{"do": "open_shutter"}' * 50]


def bad_command(chance: random.Random, token: int, last_id: str) -> tuple[str, bytes, str]:
    """Key, payload and sort of one command that must be refused while a safe permit is valid."""
    device, movement = chance.choice(MOTIONS)
    sort = chance.choice(["malformed", "tokenless", "lower token", "zero token", "replayed", "never granted"])
    if sort == "malformed":
        return device, chance.choice(MALFORMED), sort
    command = {"id": str(uuid.uuid4()), "from": "observatory/alpha/main", "do": movement}
    if sort == "lower token":
        command["token"] = chance.randrange(1, token)
    elif sort == "zero token":
        command["token"] = 0
    elif sort == "replayed":
        # the mount has done a command of this id already
        device, movement = MOUNT, chance.choice([movement for where, movement in MOTIONS if where == MOUNT])
        command.update(id=last_id, token=token, do=movement)
    elif sort == "never granted":
        # only the arbiter knows what was granted; other devices learn a higher token from it
        device, movement = DOME, chance.choice([movement for where, movement in MOTIONS if where == DOME])
        command.update(do=movement, token=token + chance.randrange(1, 1000))
    return device, json.dumps(command).encode(), sort


def bad_permit(chance: random.Random, guard: dict, received: list[dict], verdict: str) -> bytes:
    """A permit that is none: of an older lease, of another guard, for a number never sent, heard before, or unreadable."""
    permit = {"boot_id": received[-1]["boot_id"], "seq": received[-1]["seq"] + 1000, "at_utc": received[-1]["at_utc"],
              "verdict": verdict, "commander": "observatory/alpha/main", "token": guard["token"],
              "guard_number": guard["number"], "guard_boot_id": guard["boot_id"]}
    sort = chance.choice(["older token", "other guard", "number never sent", "replayed", "older life", "malformed"])
    if sort == "older token":
        permit["token"] = chance.randrange(0, guard["token"])
    elif sort == "other guard":
        permit["guard_boot_id"] = str(uuid.uuid4())
    elif sort == "number never sent":
        permit["guard_number"] += chance.randrange(5, 10 ** 6)
    elif sort == "replayed":
        permit = chance.choice(received[:-3] or received)
    elif sort == "older life":
        permit["boot_id"] = "00000000-0000-7000-8000-000000000000"
    else:
        return chance.choice(MALFORMED + [json.dumps({**permit, "verdict": "perhaps"}).encode(),
                                          json.dumps({**permit, "token": None}).encode()])
    return json.dumps(permit).encode()


def second_token(harness, subscriber) -> int:
    """The lease's token, at least 3, so that there are older ones."""
    for _ in range(3):
        token = subscriber.newest[GUARD]["token"]
        if token >= 3:
            return token
        harness.restart("observatory")
        subscriber.wait_for("the next lease", lambda newest: newest[GUARD]["token"] > token, 40)
    harness.exposes()
    return subscriber.newest[GUARD]["token"]


@case("bad motion commands under a safe sky: none is obeyed", "B3 N13", group=GROUP, watch_s=2.0)
def commands(harness):
    subscriber, chance = harness.fresh_subscriber(), random.Random(next(ATTACK_RUNS))
    token = second_token(harness, subscriber)
    harness.exposes()
    last = subscriber.wait_for("the mount's last command",
                               lambda newest: (newest.get(f"{MOUNT}/state") or {}).get("last_command"), 10)
    harness.mark()
    since, accepted, answered = harness.wire.last(), [], 0
    for _ in range(ATTACKS):
        device, payload, sort = bad_command(chance, token, last["id"])
        for reply in subscriber.session.get(f"{device}/command", payload=payload, timeout=3.0):
            if reply.ok is not None:
                answered += 1
                answer = json.loads(bytes(reply.ok.payload))
                # a repeat of an accepted command is answered as then, and must not be done again
                if answer.get("answer") == "accepted" and sort != "replayed":
                    accepted.append((sort, payload[:200], answer))
    time.sleep(0.5)
    moved = [put for put in harness.wire.puts(since) if put["member"] in MOVED]
    # without a safe permit some commands need no token; then the dome closes, too
    if any(put["member"] == "closeshutter" for put in moved):
        raise Late(f"the dome closed under a safe sky, after which {len(accepted)} commands were taken: {accepted[:2]}")
    if accepted or moved:
        raise Late(f"{len(accepted)} of {ATTACKS} bad commands accepted, {len(moved)} arrived: {accepted[:2]} {moved[:2]}")
    if answered < ATTACKS * 0.95:
        raise Late(f"only {answered} of {ATTACKS} commands were answered at all")
    yield


@case("bad permits that say unsafe: the valid one counts, nothing closes, no fence falls", "B3 N2", group=GROUP, watch_s=3.0)
def unsafe_permits(harness):
    subscriber = harness.fresh_subscriber()
    second_token(harness, subscriber)
    harness.exposes()
    harness.mark()
    publish_permits(harness, subscriber, "unsafe")
    replies = subscriber.ask(f"{MOUNT}/command", {"id": str(uuid.uuid4()), "from": "web/ops", "do": {"track": {"on": False}}})
    if [reply["answer"] for reply in replies] != ["refusal"]:
        raise Late(f"a bad permit took the fence from the mount: tracking off without a token was answered {replies}")
    yield


@case("the dome's device node restarts, then bad permits that say unsafe: the valid one counts", "B3 N2", group=GROUP, watch_s=3.0)
def unsafe_permits_after_a_restart(harness):
    # the guard's new life must know who holds the lease
    subscriber = harness.fresh_subscriber()
    second_token(harness, subscriber)
    harness.restart("dome")
    yield from unsafe_permits(harness)


@case("bad permits that say safe while it is unsafe: nothing opens", "B3 N2", ISSAFE, takes_frames_first=True)
def safe_permits(harness):
    subscriber = harness.fresh_subscriber()
    second_token(harness, subscriber)
    harness.exposes()
    since = harness.wire.last()
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    publish_permits(harness, subscriber, "safe")
    if harness.puts("openshutter", since):
        raise Late("a bad permit opened the dome")
    yield


def publish_permits(harness, subscriber, verdict: str):
    chance = random.Random(next(ATTACK_RUNS))
    permits = subscriber.wait_for("some permits", lambda _: [p for key, p in list(subscriber.received) if key == PERMIT][-30:] or None, 10)
    before = subscriber.newest[GUARD]["dropped"]
    publisher = subscriber.session.declare_publisher(PERMIT)
    for n in range(ATTACKS):
        publisher.put(bad_permit(chance, subscriber.newest[GUARD], permits, verdict))
        time.sleep(0.01)
    time.sleep(1.5)
    dropped = subscriber.newest[GUARD]["dropped"] - before
    publisher.undeclare()
    if dropped < ATTACKS * 0.5:
        raise Late(f"the guard dropped only {dropped} of {ATTACKS} bad permits")


@case("a token that is not the newest cannot open even when it is safe", "N13 B3", group=GROUP, watch_s=2.0, short=False)
def old_token_opens_nothing(harness):
    subscriber = harness.fresh_subscriber()
    token = second_token(harness, subscriber)
    harness.exposes()
    harness.mark()
    replies = subscriber.ask(f"{DOME}/command", {"id": str(uuid.uuid4()), "from": "observatory/alpha/main", "token": token - 1,
                                                 "do": "open_shutter"})
    if [r["answer"] for r in replies] != ["refusal"] or replies[0]["reason"] != "stale_token":
        raise Late(f"an old token was answered {replies}")
    yield


@case("an order to open reaches a stopped observatory node, which goes on 7 s later: nothing opens", "N2 B3", group=GROUP,
      may_close=True, watch_s=4.0)
def late_order(harness):
    subscriber = harness.fresh_subscriber()
    night, orders = f"{PREFIX}/observatory/night/state", f"{PREFIX}/observatory/order"
    seen = subscriber.wait_for("the night is heard", lambda newest: newest.get(night), 20)

    def order(name: str, do, **more):
        payload = {"id": f"late-{name}-{time.time_ns()}", "from": "cli/ana@test", "reason": "a test", "do": do, **more}
        return subscriber.ask(orders, payload, 3.0)
    if not any(answer["answer"] == "accepted" for answer in order("hold", {"stay_closed": True})):
        raise Late("the order to stay closed was not accepted")
    wait("closed", lambda: harness.wire.open_fraction() == 0.0, 30)
    since = harness.wire.last()
    seen = subscriber.wait_for("a new state of the night", lambda newest: newest[night] if newest[night]["seq"] > seen["seq"] else None, 20)
    harness.signal(signal.SIGSTOP, "observatory")
    stopped = time.monotonic()
    late = [{"seen": {"boot_id": seen["boot_id"], "seq": seen["seq"]}}, {}]
    answered = [order(f"open-{n}", {"stay_closed": False}, **more) for n, more in enumerate(late)]
    time.sleep(max(0.0, stopped + 7.0 - time.monotonic()))
    harness.signal(signal.SIGCONT, "observatory")
    harness.mark()
    time.sleep(12.0)
    if any(answered) or harness.puts("openshutter", since):
        raise Late(f"a late order was executed: answers {answered}")
    # one that is given now is executed
    fresh = subscriber.wait_for("the night goes on", lambda newest: newest[night], 5)
    if not order("open", {"stay_closed": False}, seen={"boot_id": fresh["boot_id"], "seq": fresh["seq"]}):
        raise Late("an order that is given in time was not answered")
    yield
