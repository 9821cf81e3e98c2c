"""Inputs of the verdict: unsafe, beyond a limit, silent, frozen, nonsense; and the five that read safe elsewhere."""

import json
import time

from case import ISSAFE, MONITOR_SILENT, SUN, WEATHER, WEATHER_SILENT, case
from relay import RESET
from harness import DWELL_MIN, PREFIX, Late, arrived_s, wait


def unsafe(harness):
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


for phase in ["opening", "slewing", "exposing", "downloading"]:
    case(f"IsSafe says false while {phase}", "S1", ISSAFE, phase=phase)(unsafe)


@case("rain", "S1 S7", ISSAFE)
def rain(harness):
    harness.mark()
    harness.wire.change("rain", on=True)
    yield


@case("IsSafe flaps: one false is enough, and it stays closed for its dwell", "S9 D6", ISSAFE)
def flaps(harness):
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    time.sleep(2.2)
    harness.wire.change("safety", unsafe=False)
    yield


def weather(**values):
    def run(harness):
        harness.mark()
        harness.wire.change("weather", **values)
        yield
    return run


# below what the simulated monitor itself calls unsafe, so that the limit alone speaks
case("humidity beyond its limit", "S1 S7", WEATHER)(weather(Humidity=85.0))
case("wind beyond its limit", "S1 S7", WEATHER, short=False)(weather(WindSpeed=15.0, WindGust=15.1, Humidity=81.0))


def monitor_fault(**fault):
    def run(harness):
        harness.mark()
        harness.wire.fault("safetymonitor", **fault)
        yield
    return run


def weather_fault(**fault):
    def run(harness):
        harness.mark()
        harness.wire.fault("observingconditions", **fault)
        yield
    return run


FAULTS = {"refuses": {"refuse": True}, "hangs": {"hang": True}, "answers after 30 s": {"slow_ms": 30_000},
          "answers HTML": {"html": True}, "answers error 0x4FF": {"error": 0x4FF}, "answers error 0x407": {"error": 0x407}}
for word, fault in FAULTS.items():
    hazards = {"refuses": "S2 D2", "hangs": "S2 D1", "answers after 30 s": "S2 D1"}.get(word, "S5")
    case(f"safety monitor {word}", hazards, MONITOR_SILENT)(monitor_fault(**fault))
    case(f"weather station {word}", hazards + " S3", WEATHER_SILENT,
         short=word in ("hangs", "answers HTML"))(weather_fault(**fault))


@case("predecessor A: no weather at all", "S3 S4", WEATHER_SILENT)
def no_weather(harness):
    harness.mark()
    harness.relays["observingconditions"].gone = True
    yield


@case("predecessor B: the rain sensor is missing while humidity reports", "S4 S7", WEATHER_SILENT)
def no_rain_sensor(harness):
    def spoil(member, raw):
        if member not in ("devicestate", "rainrate"):
            return None
        envelope = json.loads(raw)
        if member == "rainrate":
            envelope.pop("Value", None)
            envelope.update(ErrorNumber=0x402, ErrorMessage="no rain sensor")
        else:
            envelope["Value"] = [entry for entry in envelope["Value"] if entry["Name"] != "RainRate"]
        return json.dumps(envelope).encode()
    harness.mark()
    harness.relays["observingconditions"].spoil = spoil
    yield


@case("predecessor C: the newest measurement is 25 minutes old", "S3", WEATHER_SILENT)
def old_weather(harness):
    harness.mark()
    harness.relays["observingconditions"].answer_value("timesincelastupdate", "1500.0")
    yield


def old_sensor(age: str):
    def run(harness):
        harness.mark()
        harness.relays["observingconditions"].answer_value("timesincelastupdate(RainRate)", age)
        yield
    return run


case("the rain sensor alone measured 25 minutes ago; its station is alive", "S3", WEATHER_SILENT)(old_sensor("1500.0"))
case("the rain sensor alone never measured anything", "S3", WEATHER_SILENT)(old_sensor("-1.0"))
case("the rain sensor's age is NaN", "S3 S4", WEATHER_SILENT, short=False)(old_sensor("NaN"))
case("predecessor D: every value is NaN", "S4", WEATHER_SILENT)(weather_fault(nan=True))


@case("predecessor E: one IsSafe poll is missing; the next false closes", "S4 S6", ISSAFE)
def one_poll_missing(harness):
    left = [2]  # a reading is asked for twice when the connection breaks
    since = harness.wire.last()
    harness.mark()

    def spoil(member, raw):
        if member == "issafe" and left[0] > 0:
            left[0] -= 1
            return RESET
        return None
    harness.relays["safetymonitor"].spoil = spoil
    wait("the poll is missed", lambda: left[0] == 0, 5)
    time.sleep(1.5)
    if not harness.puts("closeshutter", since):  # a single miss need not close, but what follows must
        harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield


def answers_with(value: str):
    def run(harness):
        harness.mark()
        harness.relays["safetymonitor"].answer_value("issafe", value)
        yield
    return run


for value in ['"True"', "1", "null"]:
    case(f"IsSafe is {value}", "S4", MONITOR_SILENT, short=value != "1")(answers_with(value))


def changed(change):
    def run(harness):
        harness.mark()
        harness.relays["safetymonitor"].change_answer("issafe", change)
        yield
    return run


case("IsSafe without a Value", "S4", MONITOR_SILENT)(changed(lambda e: e.pop("Value") and None))
case("IsSafe answers another transaction", "S6", MONITOR_SILENT)(
    changed(lambda e: e.update(ClientTransactionID=e["ClientTransactionID"] + 7)))
case("IsSafe true beside an error number", "S5", MONITOR_SILENT)(
    changed(lambda e: e.update(ErrorNumber=0x500, ErrorMessage="sensor lost")))


@case("safety monitor vanishes and returns as another number", "D9", MONITOR_SILENT)
def another_number(harness):
    """The server answers, and device 0 is not there any more."""
    harness.mark()
    harness.relays["safetymonitor"].renumber = {"0": "9"}
    yield


def bad_values() -> list[str]:
    """At least 400 JSON texts that are not `true`."""
    plain = ["false", "null", "0", "1", "-1", "NaN", "Infinity", "-Infinity", "1e999", "[]", "{}", "[true]", '""', '" "']
    words = ["true", "True", "TRUE", "yes", "on", "safe", "ok", "1", "0", "false", "False", "null", "None", "nan", "T", "Y"]
    quoted = [json.dumps(pad[0] + word + pad[1]) for word in words for pad in [("", ""), (" ", ""), ("", "\n"), ("\ufeff", "")]]
    numbers = [repr(n * 0.5) for n in range(-60, 61)] + [str(2 ** n) for n in range(1, 64)] + [f"1e{n}" for n in range(-50, 51, 3)]
    nested = [json.dumps({"Value": True, "n": n}) for n in range(40)] + [json.dumps([True] * n) for n in range(2, 42)]
    texts = [json.dumps("true" * n) for n in range(2, 42)]
    return list(dict.fromkeys(plain + quoted + numbers + nested + texts))


BAD = bad_values()


@case(f"{len(BAD)} bad values of IsSafe: none reads as safe", "S4 S6", group="bad IsSafe values",
      may_close=True, watch_s=0.0)
def none_reads_safe(harness):
    relay, served = harness.relays["safetymonitor"], [0]
    key = f"{PREFIX}/device/safetymonitor/monitor/state"
    config = harness.configuration
    text = config.read_text()
    # ten polls a second, so that each value is asked for
    config.write_text(text.replace(f"dwell_min = {DWELL_MIN}\n", f"dwell_min = {DWELL_MIN}\nperiod_s = 0.1\n", 1))
    current = ["false"]

    def spoil(member, raw):
        if member != "issafe":
            return None
        envelope = json.loads(raw)
        envelope["Value"] = "\0"
        served[0] += 1
        return json.dumps(envelope).replace('"\\u0000"', current[0]).encode()
    relay.spoil = spoil
    harness.restart("hands")
    # three in a row, so that what was safe before the first has been said
    before = served[0]
    wait("the monitor is asked again", lambda: served[0] > before + 3, 20)
    subscriber = harness.fresh_subscriber()
    received = len(subscriber.received)
    since = harness.wire.last()
    for value in BAD:
        before, current[0] = served[0], value
        wait(f"IsSafe {value} is asked for", lambda: served[0] >= before + 1, 10, 0.01)
    time.sleep(0.5)
    states = [payload["fields"]["is_safe"] for where, payload in subscriber.received[received:] if where == key]
    read_safe = [reading for reading in states
                 if reading is True or (isinstance(reading, dict) and reading.get("value") is True)]
    if len(states) < 20:
        raise Late(f"only {len(states)} states of the monitor were heard")
    config.write_text(text)
    if read_safe or harness.puts("openshutter", since):
        raise Late(f"{len(read_safe)} of {len(BAD)} bad values read as safe, or something opened")
    yield
    harness.restart("hands")


@case("the Sun rises above its limit while the schedule runs", "S11", SUN, takes_frames_first=True)
def sun(harness):
    # a loaded machine takes 20 s and more until the restarted node exposes
    rises_deg_per_s = harness.sun_rises(lead_s=45.0)
    since = harness.wire.last()
    # the node's Sun may cross a moment before the simulator's
    wait("the Sun crosses the limit", lambda: harness.puts("closeshutter", since)
         or harness.wire.world()["sun_altitude_deg"] > harness.sun_max_deg, 60, 0.05)
    left_deg = harness.sun_max_deg - harness.wire.world()["sun_altitude_deg"]
    if left_deg > 2.0 * rises_deg_per_s:
        raise Late(f"it closed {left_deg / rises_deg_per_s:.1f} s before the Sun crossed the limit")
    harness.mark()
    closing = harness.puts("closeshutter", since)
    harness.t0 = min([harness.t0, *map(arrived_s, closing)])
    yield
    harness.sun_is_down()
