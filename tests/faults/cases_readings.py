"""How old a reading is, who says it, and whether it is an answer at all: what reads as safe although the sky is not."""

import json
import signal
import threading
import time

from case import HANDS, MONITOR_SILENT, SUN, WEATHER_SILENT, Bound, case
from cases_loops import TWICE, TWICE_S
from flavours import SHARED_PERIOD_S
from relay import AlpacaRelay
from rig import DWELL_MIN, PREFIX, Late, arrived_s, free_port, wait
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


def stays_closed(rig, since: int, seconds: float, why: str):
    """What nobody may open, for so long."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if rig.puts("openshutter", since) or rig.wire.open_fraction() > 0.0:
            raise Late(f"it opened {why}")
        time.sleep(0.2)


def stalls(stop, go_on):
    """The monitor's node stalls, the sky turns meanwhile, and the node goes on with what it read before."""
    def run(rig):
        rig.mark()
        stop(rig)
        yield
        rig.wire.change("safety", unsafe=True)
        time.sleep(max(0.0, rig.t0 + STALL_S - time.time()))
        since = rig.wire.last()
        go_on(rig)
        # longer than the dwell, which would begin anew
        stays_closed(rig, since, DWELL_MIN * 60.0 + 8.0, "on a reading of before the stall, under an unsafe sky")
    return run


case(f"the monitor's node stalls for {STALL_S:.0f} s, and the sky turns meanwhile", "N5 S2 S6", HANDS)(stalls(
    lambda rig: rig.signal(signal.SIGSTOP, "hands"), lambda rig: rig.signal(signal.SIGCONT, "hands")))


@case(f"the monitor's node stalls for {STALL_S:.0f} s as an answer arrives, and the sky turns meanwhile", "N5 S2 S6", HANDS)
def stalls_at_answer(rig):
    """The answer waits in the node's socket, so it is the first that the node reads when it goes on."""
    stopped = threading.Event()

    def stop(member):
        if member == "issafe" and not stopped.is_set():
            rig.mark()
            rig.signal(signal.SIGSTOP, "hands")
            stopped.set()
    rig.relays["safetymonitor"].after = stop
    wait("the monitor is asked", stopped.is_set, 10, 0.01)
    yield
    rig.wire.change("safety", unsafe=True)
    time.sleep(max(0.0, rig.t0 + STALL_S - time.time()))
    since = rig.wire.last()
    rig.signal(signal.SIGCONT, "hands")
    stays_closed(rig, since, DWELL_MIN * 60.0 + 8.0, "on an answer of before the stall, under an unsafe sky")


@case(f"an answer of the monitor is {STALL_S:.0f} s under way, and the sky turns meanwhile", "D1 S2 S6", MONITOR_SILENT)
def old_answer(rig):
    relay, held = rig.relays["safetymonitor"], threading.Event()
    relay.after = lambda member: held.wait(STALL_S)
    rig.mark()
    yield
    rig.wire.change("safety", unsafe=True)
    time.sleep(max(0.0, rig.t0 + STALL_S - time.time()))
    since = rig.wire.last()
    held.set()
    stays_closed(rig, since, DWELL_MIN * 60.0 + 8.0, "on an old answer, under an unsafe sky")


@case(f"answers of the monitor are {UNDER_WAY_S:.0f} s under way, and it is unsafe", "D1 S6", MONITOR_SILENT)
def slow_answers(rig):
    rig.mark()
    rig.relays["safetymonitor"].after = lambda member: time.sleep(UNDER_WAY_S)
    rig.wire.change("safety", unsafe=True)
    yield


def slow_station(rig):
    """A station without DeviceState that needs its time for each property, as some drivers over a serial line do."""
    relay = rig.relays["observingconditions"]

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
def slow_and_safe(rig):
    slow_station(rig)
    yield


@case("the weather station becomes slow in the midst of what decides nothing: the dome stays open", "D1 S3", group=HEALTHY,
      watch_s=20.0)
def slow_in_the_rest(rig):
    is_slow = threading.Event()

    def before(member):
        if member == "pressure":
            is_slow.set()
        if is_slow.is_set():
            time.sleep(PER_PROPERTY_S)
    rig.relays["observingconditions"].before = before
    yield


@case(f"the weather station needs {PER_PROPERTY_S} s per property, and it rains", "D1 S3 S7", WEATHER_SILENT)
def slow_and_rain(rig):
    no_device_state = slow_station(rig)
    # it has gone round several times, and is in the midst of one
    time.sleep(20.0)
    if rig.wire.open_fraction() != 1.0:
        raise Late("the dome is not open beside a slow station under a safe sky")

    def raining(member, raw):
        if member != "rainrate":
            return no_device_state(member, raw)
        return json.dumps({**json.loads(raw), "Value": 5.0}).encode()
    rig.mark()
    rig.relays["observingconditions"].spoil = raining
    yield


@case(f"the site's own monitor is asked each {SHARED_PERIOD_S:.0f} s: the dome stays open", "S2 S9", group=HEALTHY,
      flavour="site", watch_s=60.0)
def shared_period(rig):
    yield


@case("the site's own monitor says false", "S1", SHARED, flavour="site")
def shared_unsafe(rig):
    rig.mark()
    rig.wire.change("safety", unsafe=True)
    yield


@case("the node of the site's own monitor is stopped", "S2 N5", Bound("the site's own monitor is silent (allowed age 5 periods)",
      5 * SHARED_PERIOD_S + 2.0), flavour="site")
def shared_silent(rig):
    rig.mark()
    rig.processes["shared"].send_signal(signal.SIGSTOP)
    yield
    rig.processes["shared"].send_signal(signal.SIGCONT)


@case("a second writer says that it is safe, and it is not", "N14 S1 S6", TWICE)
def second_writer(rig):
    """Another device node with a monitor of the same name, whose server always says safe."""
    liar = AlpacaRelay("127.0.0.1", rig.wire.address)
    liar.say_value("issafe", "true")
    try:
        honest = rig.relays["safetymonitor"].address
        text = rig.configuration.read_text()
        block = next(part for part in text.split("[[") if part.startswith("safetymonitor"))
        lying = block.replace(honest, liar.address).replace('node = "hands"', 'node = "liar"')
        (rig.folder / "liar.toml").write_text(text.replace(block, lying))
        command = rig.command("hands", "liar", f"tcp/127.0.0.1:{free_port()}")
        command[command.index("--config") + 1] = str(rig.folder / "liar.toml")
        rig.mark()  # two living writers of one input are unsafe by themselves
        rig.spawn("liar", [*command, "--connect", rig.endpoint("hands")])
        time.sleep(TWICE_S)
        rig.wire.change("safety", unsafe=True)
        yield
        stays_closed(rig, rig.wire.last(), 10.0, "while one of two writers says unsafe")
        rig.wire.change("safety", unsafe=False)
        stays_closed(rig, rig.wire.last(), DWELL_MIN * 60.0 + 5.0, "while two write one safety input")
    finally:
        if "liar" in rig.processes:
            rig.end("liar")
        liar.stop()


def twin_of_another_time(seconds: int):
    """A copy of the dome's device node on a machine whose clock is off."""
    def run(rig):
        clock = WallClock(rig.shifts / "twin")
        clock.jump(seconds)
        rig.mark()
        command = rig.command("dome", "dome", f"tcp/127.0.0.1:{free_port()}") + ["--connect", rig.endpoint("observatory")]
        rig.spawn("twin", command, clock.environment)
        try:
            time.sleep(TWICE_S)
            rig.wire.change("safety", unsafe=True)
            yield
            if rig.processes["dome"].poll() is not None:
                raise Late("the dome's device node left because of the clock of another one")
        finally:
            rig.end("twin")
    return run


for seconds in (-HOUR_S, HOUR_S):
    case(f"a twin of the dome's device node whose clock is off by {seconds // HOUR_S:+d} h, then it is unsafe", "N14 N17", TWICE,
         flavour="wall")(twin_of_another_time(seconds))


@case("the clock of the observatory goes back 1 h as the Sun rises", "S11 N17", SUN, flavour="sun", takes_frames_first=True)
def sun_and_step(rig):
    before, began = rig.wire.world()["sun_altitude_deg"], time.monotonic()
    time.sleep(3.0)
    altitude_deg = rig.wire.world()["sun_altitude_deg"]
    rises_deg_per_s = (altitude_deg - before) / (time.monotonic() - began)
    if rises_deg_per_s <= 0.0:
        raise Late("the Sun does not rise in this rig's world")
    rig.sun_max_deg = altitude_deg + rises_deg_per_s * 20.0
    rig.write_config()
    rig.restart("observatory")
    rig.exposes(30)
    since = rig.wire.last()
    rig.jump("observatory", -HOUR_S)
    # a clock that is not believed may close before
    wait("the Sun crosses the limit", lambda: rig.puts("closeshutter", since)
         or rig.wire.world()["sun_altitude_deg"] > rig.sun_max_deg, 60, 0.05)
    rig.mark()
    rig.t0 = min([rig.t0, *map(arrived_s, rig.puts("closeshutter", since))])
    yield
    rig.jump("observatory", 0)
    rig.sun_max_deg = 90.0
    rig.write_config()
    rig.restart("observatory")


def other(**changes):
    return lambda said: json.dumps({**said, "Value": True, **changes})


def without(*names: str):
    return lambda said: json.dumps({name: value for name, value in {**said, "Value": True}.items() if name not in names})


def text(change):
    return lambda said: change(json.dumps({**said, "Value": True}))


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
    "of another transaction": lambda said: json.dumps({**said, "Value": True, "ClientTransactionID": said["ClientTransactionID"] + 1}),
    "of transaction -1": other(ClientTransactionID=-1),
    "of a transaction in text": lambda said: json.dumps({**said, "Value": True, "ClientTransactionID": "x"}),
    "of a transaction and a half": lambda said: json.dumps({**said, "Value": True, "ClientTransactionID": said["ClientTransactionID"] + 0.5}),
    "cut off": text(lambda t: t[:-1]),
    "with another answer behind it": text(lambda t: t + t.replace("true", "false")),
    "with letters behind it": text(lambda t: t + "x"),
    "a list of answers": text(lambda t: f"[{t}]"),
    "only true": lambda said: "true",
    "a text of an answer": text(json.dumps),
    "empty": lambda said: "",
    "without Value": without("Value"),
}


@case(f"{len(ODD_ANSWERS)} odd answers of IsSafe: none reads as safe", "S4 S5 S6", group=ODD, may_close=True, watch_s=0.0)
def odd_answers(rig):
    relay, served = rig.relays["safetymonitor"], [0]
    current = [lambda said: json.dumps({**said, "Value": False})]

    def spoil(member, raw):
        if member != "issafe":
            return None
        served[0] += 1
        return current[0](json.loads(raw)).encode()
    ear = rig.fresh_ear()
    key = f"{PREFIX}/device/safetymonitor/monitor/state"
    relay.spoil = spoil
    rig.mark()
    wait("the dome closes", lambda: rig.wire.open_fraction() == 0.0, 20)
    since, reads_safe = rig.wire.last(), []
    for word, answer in ODD_ANSWERS.items():
        current[0] = answer
        # the second question comes after the state with the answer to the first
        before, heard = served[0], len(ear.heard)
        wait(f"IsSafe is asked again: {word}", lambda: served[0] >= before + 2, 20, 0.02)
        time.sleep(0.2)
        said = [payload["fields"]["is_safe"] for where, payload in ear.heard[heard:] if where == key]
        if any(value is True or (isinstance(value, dict) and value.get("value") is True) for value in said):
            reads_safe.append(word)
    if reads_safe or rig.puts("openshutter", since):
        raise Late(f"{len(reads_safe)} of {len(ODD_ANSWERS)} odd answers read as safe: {', '.join(reads_safe)}; or it opened")
    yield


