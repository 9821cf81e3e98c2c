"""How old a reading is, who says it, and whether it is an answer at all: what reads as safe although the sky is not."""

import json
import signal
import threading
import time

from case import HANDS, MONITOR_SILENT, SUN, WEATHER_SILENT, Bound, case
from cases_loops import TWICE, TWICE_S
from flavours import SHARED_PERIOD_S
from relay import AlpacaRelay
from harness import DWELL_MIN, PREFIX, Late, arrived_s, free_port, wait
from wall_clock import WallClock

HOUR_S = 3600
STALL_S = 12.0
# how long a slow weather station needs for each of its properties
PER_PROPERTY_S = 1.2
# an answer is so long under way
UNDER_WAY_S = 3.0
SHARED = Bound("IsSafe of the site's monitor says false (asked each 5 s)", SHARED_PERIOD_S + 2.0)
HEALTHY = "healthy monitor or station that is slow: nothing closes"
ODD = "odd answers of IsSafe"


def stays_closed(harness, since: int, seconds: float, why: str):
    """What nobody may open, for so long."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if harness.puts("openshutter", since) or harness.wire.open_fraction() > 0.0:
            raise Late(f"it opened {why}")
        time.sleep(0.2)


def stalls(stop, go_on):
    """The monitor's node stalls, the sky turns meanwhile, and the node goes on with what it read before."""
    def run(harness):
        harness.mark()
        stop(harness)
        yield
        harness.wire.change("safety", unsafe=True)
        time.sleep(max(0.0, harness.t0 + STALL_S - time.time()))
        since = harness.wire.last()
        go_on(harness)
        # longer than the dwell, which would begin anew
        stays_closed(harness, since, DWELL_MIN * 60.0 + 8.0, "on a reading of before the stall, under an unsafe sky")
    return run


case(f"the monitor's node stalls for {STALL_S:.0f} s, and the sky turns meanwhile", "N5 S2 S6", HANDS)(stalls(
    lambda harness: harness.signal(signal.SIGSTOP, "hands"), lambda harness: harness.signal(signal.SIGCONT, "hands")))


@case(f"the monitor's node stalls for {STALL_S:.0f} s as an answer arrives, and the sky turns meanwhile", "N5 S2 S6", HANDS)
def stalls_at_answer(harness):
    """The answer waits in the node's socket, so it is the first that the node reads when it goes on."""
    stopped = threading.Event()

    def stop(member):
        if member == "issafe" and not stopped.is_set():
            harness.mark()
            harness.signal(signal.SIGSTOP, "hands")
            stopped.set()
    harness.relays["safetymonitor"].after = stop
    wait("the monitor is asked", stopped.is_set, 10, 0.01)
    yield
    harness.wire.change("safety", unsafe=True)
    time.sleep(max(0.0, harness.t0 + STALL_S - time.time()))
    since = harness.wire.last()
    harness.signal(signal.SIGCONT, "hands")
    stays_closed(harness, since, DWELL_MIN * 60.0 + 8.0, "on an answer of before the stall, under an unsafe sky")


@case(f"an answer of the monitor is {STALL_S:.0f} s under way, and the sky turns meanwhile", "D1 S2 S6", MONITOR_SILENT)
def old_answer(harness):
    relay, held = harness.relays["safetymonitor"], threading.Event()
    relay.after = lambda member: held.wait(STALL_S)
    harness.mark()
    yield
    harness.wire.change("safety", unsafe=True)
    time.sleep(max(0.0, harness.t0 + STALL_S - time.time()))
    since = harness.wire.last()
    held.set()
    stays_closed(harness, since, DWELL_MIN * 60.0 + 8.0, "on an old answer, under an unsafe sky")


@case(f"answers of the monitor are {UNDER_WAY_S:.0f} s under way, and it is unsafe", "D1 S6", MONITOR_SILENT)
def slow_answers(harness):
    harness.mark()
    harness.relays["safetymonitor"].after = lambda member: time.sleep(UNDER_WAY_S)
    harness.wire.change("safety", unsafe=True)
    yield


def slow_station(harness):
    """A station without DeviceState that needs its time for each property, as some drivers over a serial line do."""
    relay = harness.relays["observingconditions"]

    def no_device_state(member, raw):
        if member != "devicestate":
            return None
        envelope = json.loads(raw)
        envelope.pop("Value", None)
        envelope.update(ErrorNumber=0x400, ErrorMessage="not implemented")
        return json.dumps(envelope).encode()
    relay.spoil = no_device_state
    relay.before = lambda member: time.sleep(PER_PROPERTY_S)
    return no_device_state


@case(f"the weather station needs {PER_PROPERTY_S} s per property: the dome stays open", "D1 S3", group=HEALTHY, watch_s=40.0)
def slow_and_safe(harness):
    slow_station(harness)
    yield


@case("the weather station becomes slow in the midst of what decides nothing: the dome stays open", "D1 S3", group=HEALTHY,
      watch_s=20.0)
def slow_in_the_rest(harness):
    is_slow = threading.Event()

    def before(member):
        if member == "pressure":
            is_slow.set()
        if is_slow.is_set():
            time.sleep(PER_PROPERTY_S)
    harness.relays["observingconditions"].before = before
    yield


@case(f"the weather station needs {PER_PROPERTY_S} s per property, and it rains", "D1 S3 S7", WEATHER_SILENT)
def slow_and_rain(harness):
    no_device_state = slow_station(harness)
    # it has gone round several times, and is in the midst of one
    time.sleep(20.0)
    if harness.wire.open_fraction() != 1.0:
        raise Late("the dome is not open with a slow station under a safe sky")

    def raining(member, raw):
        if member != "rainrate":
            return no_device_state(member, raw)
        return json.dumps({**json.loads(raw), "Value": 5.0}).encode()
    harness.mark()
    harness.relays["observingconditions"].spoil = raining
    yield


@case(f"the site's own monitor is asked each {SHARED_PERIOD_S:.0f} s: the dome stays open", "S2 S9", group=HEALTHY,
      flavour="site", watch_s=60.0)
def shared_period(harness):
    yield


@case("the site's own monitor says false", "S1", SHARED, flavour="site")
def shared_unsafe(harness):
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


@case("the node of the site's own monitor is stopped", "S2 N5", Bound("the site's own monitor is silent (allowed age 5 periods)",
      5 * SHARED_PERIOD_S + 2.0), flavour="site")
def shared_silent(harness):
    harness.mark()
    harness.processes["shared"].send_signal(signal.SIGSTOP)
    yield
    harness.processes["shared"].send_signal(signal.SIGCONT)


@case("a second writer says that it is safe, and it is not", "N14 S1 S6", TWICE)
def second_writer(harness):
    """Another device node with a monitor of the same name, whose server always says safe."""
    liar = AlpacaRelay("127.0.0.1", harness.wire.address)
    liar.answer_value("issafe", "true")
    try:
        honest = harness.relays["safetymonitor"].address
        text = harness.configuration.read_text()
        block = next(part for part in text.split("[[") if part.startswith("safetymonitor"))
        lying = block.replace(honest, liar.address).replace('node = "hands"', 'node = "liar"')
        (harness.folder / "liar.toml").write_text(text.replace(block, lying))
        command = harness.command("hands", "liar", f"tcp/127.0.0.1:{free_port()}")
        command[command.index("--config") + 1] = str(harness.folder / "liar.toml")
        harness.mark()  # two living writers of one input are unsafe by themselves
        harness.spawn("liar", [*command, "--connect", harness.endpoint("hands")])
        time.sleep(TWICE_S)
        harness.wire.change("safety", unsafe=True)
        yield
        stays_closed(harness, harness.wire.last(), 10.0, "while one of two writers says unsafe")
        harness.wire.change("safety", unsafe=False)
        stays_closed(harness, harness.wire.last(), DWELL_MIN * 60.0 + 5.0, "while two write one safety input")
    finally:
        if "liar" in harness.processes:
            harness.end("liar")
        liar.stop()


def twin_of_another_time(seconds: int):
    """A copy of the dome's device node on a machine whose clock is off."""
    def run(harness):
        clock = WallClock(harness.shifts / "twin")
        clock.jump(seconds)
        harness.mark()
        command = harness.command("dome", "dome", f"tcp/127.0.0.1:{free_port()}") + ["--connect", harness.endpoint("observatory")]
        harness.spawn("twin", command, clock.environment)
        try:
            time.sleep(TWICE_S)
            harness.wire.change("safety", unsafe=True)
            yield
            if harness.processes["dome"].poll() is not None:
                raise Late("the dome's device node left because of the clock of another one")
        finally:
            harness.end("twin")
    return run


for seconds in (-HOUR_S, HOUR_S):
    case(f"a twin of the dome's device node whose clock is off by {seconds // HOUR_S:+d} h, then it is unsafe", "N14 N17", TWICE,
         flavour="wall")(twin_of_another_time(seconds))


@case("the clock of the observatory goes back 1 h as the Sun rises", "S11 N17", SUN, flavour="sun", takes_frames_first=True)
def sun_and_step(harness):
    harness.sun_rises(lead_s=45.0)
    since = harness.wire.last()
    harness.jump("observatory", -HOUR_S)
    # a clock that is not believed may close before
    wait("the Sun crosses the limit", lambda: harness.puts("closeshutter", since)
         or harness.wire.world()["sun_altitude_deg"] > harness.sun_max_deg, 60, 0.05)
    harness.mark()
    harness.t0 = min([harness.t0, *map(arrived_s, harness.puts("closeshutter", since))])
    yield
    harness.jump("observatory", 0)
    harness.sun_is_down()


def other(**changes):
    return lambda reply: json.dumps({**reply, "Value": True, **changes})


def without(*names: str):
    return lambda reply: json.dumps({name: value for name, value in {**reply, "Value": True}.items() if name not in names})


def text(change):
    return lambda reply: change(json.dumps({**reply, "Value": True}))


# beside each: what the answer is; `Value` says true in all of them, and none is the answer to the question
ODD_ANSWERS = {
    "Value True": text(lambda t: t.replace("true", "True")),
    "Value TRUE": text(lambda t: t.replace("true", "TRUE")),
    "Value twice, false first": text(lambda t: t.replace('"Value": true', '"Value": false, "Value": true')),
    "Value twice, true first": text(lambda t: t.replace('"Value": true', '"Value": true, "Value": false')),
    "Value twice, both true": text(lambda t: t.replace('"Value": true', '"Value": true, "Value": true')),
    "value in small letters": text(lambda t: t.replace("Value", "value")),
    "Value within a list": other(Value=[True]),
    "Value within an object": other(Value={"Value": True}),
    "ErrorNumber 0.5": other(ErrorNumber=0.5),
    "ErrorNumber -1": other(ErrorNumber=-1),
    "ErrorNumber 1024": other(ErrorNumber=1024),
    "ErrorNumber text": other(ErrorNumber="0x400"),
    "ErrorNumber an object": other(ErrorNumber={"code": 1}),
    "ErrorNumber true": other(ErrorNumber=True),
    "ErrorNumber twice": text(lambda t: t.replace('"ErrorNumber": 0', '"ErrorNumber": 0, "ErrorNumber": 1024')),
    "ErrorMessage an object": other(ErrorMessage={"text": "sensor lost"}, ErrorNumber=1),
    "of another transaction": lambda reply: json.dumps({**reply, "Value": True, "ClientTransactionID": reply["ClientTransactionID"] + 1}),
    "of transaction -1": other(ClientTransactionID=-1),
    "of a transaction in text": lambda reply: json.dumps({**reply, "Value": True, "ClientTransactionID": "x"}),
    "of a transaction and a half": lambda reply: json.dumps({**reply, "Value": True, "ClientTransactionID": reply["ClientTransactionID"] + 0.5}),
    "cut off": text(lambda t: t[:-1]),
    "with another answer behind it": text(lambda t: t + t.replace("true", "false")),
    "with letters behind it": text(lambda t: t + "x"),
    "a list of answers": text(lambda t: f"[{t}]"),
    "only true": lambda reply: "true",
    "a text of an answer": text(json.dumps),
    "empty": lambda reply: "",
    "without Value": without("Value"),
}


@case(f"{len(ODD_ANSWERS)} odd answers of IsSafe: none reads as safe", "S4 S5 S6", group=ODD, may_close=True, watch_s=0.0)
def odd_answers(harness):
    relay, served = harness.relays["safetymonitor"], [0]
    current = [lambda reply: json.dumps({**reply, "Value": False})]

    def spoil(member, raw):
        if member != "issafe":
            return None
        served[0] += 1
        return current[0](json.loads(raw)).encode()
    subscriber = harness.fresh_subscriber()
    key = f"{PREFIX}/device/safetymonitor/monitor/state"
    relay.spoil = spoil
    harness.mark()
    wait("the dome closes", lambda: harness.wire.open_fraction() == 0.0, 20)
    since, reads_safe = harness.wire.last(), []
    for word, answer in ODD_ANSWERS.items():
        current[0] = answer
        # the second question comes after the state with the answer to the first
        before, received = served[0], len(subscriber.received)
        wait(f"IsSafe is asked again: {word}", lambda: served[0] >= before + 2, 20, 0.02)
        time.sleep(0.2)
        readings = [payload["fields"]["is_safe"] for where, payload in subscriber.received[received:] if where == key]
        if any(value is True or (isinstance(value, dict) and value.get("value") is True) for value in readings):
            reads_safe.append(word)
    if reads_safe or harness.puts("openshutter", since):
        raise Late(f"{len(reads_safe)} of {len(ODD_ANSWERS)} odd answers read as safe: {', '.join(reads_safe)}; or it opened")
    yield


