"""Faults that Starmesh and its predecessor can both take, put in between in the same way for both."""

import json
import os
import signal
import time

import exhaust
from loopback import wait
from relay import RESET

CASES: dict[str, object] = {}
MISSING = object()


def case(name: str):
    def register(run):
        CASES[name] = run
        return run
    return register


# -- the sky

@case("IsSafe says false")
def unsafe(site):
    site.unsafe()
    yield


@case("rain beyond its limit")
def rain(site):
    site.weather(rainrate=5.0)
    yield


@case("humidity beyond its limit")
def humidity(site):
    site.weather(humidity=95.0)
    yield


# -- the safety monitor

def monitor(name: str):
    """A case that breaks the monitor's server; the moment of the fault counts."""
    def register(fault):
        def run(site):
            site.mark()
            fault(site.relays["safetymonitor"])
            yield
        CASES[name] = run
    return register


@monitor("safety monitor hangs")
def monitor_hangs(relay):
    relay.hang()


@monitor("safety monitor's server refuses")
def monitor_refuses(relay):
    relay.refuse()


@monitor("safety monitor answers HTML")
def monitor_html(relay):
    relay.spoil = lambda member, raw: b"<html><body>502 Bad Gateway</body></html>"


for value in ["NaN", "null", '"False"', "0"]:
    monitor(f"IsSafe is {value}")(lambda relay, value=value: relay.answer_value("issafe", value))


@case("safety monitor answers 20 s late, and it is unsafe")
def monitor_late(site):
    def spoil(member, raw):
        if member == "issafe":
            time.sleep(20.0)
        return None
    site.relays["safetymonitor"].spoil = spoil
    site.unsafe()
    yield


# -- the weather station

def measured(change):
    """`change(property, value)` for each measurement, asked for singly or as DeviceState; MISSING: there is no such sensor."""
    def spoil(member, raw):
        try:
            envelope = json.loads(raw)
        except ValueError:
            return None
        value = envelope.get("Value")
        if member == "devicestate":
            changed = [{**entry, "Value": change(entry["Name"].lower(), entry["Value"])} for entry in value]
            envelope["Value"] = [entry for entry in changed if entry["Value"] is not MISSING]
        elif isinstance(value, float):
            envelope["Value"] = change(member, value)
            if envelope["Value"] is MISSING:
                envelope.pop("Value")
                envelope.update(ErrorNumber=0x402, ErrorMessage="no such sensor")
        return json.dumps(envelope).encode()
    return spoil


@case("A: no weather rows: the station hangs, and it rains")
def weather_hangs(site):
    site.relays["observingconditions"].hang()
    site.weather(rainrate=5.0)
    yield


@case("weather station's server refuses")
def weather_refuses(site):
    site.mark()
    site.relays["observingconditions"].refuse()
    yield


@case("B: the rain sensor is missing while humidity reports")
def no_rain_sensor(site):
    site.mark()
    site.relays["observingconditions"].spoil = measured(lambda name, value: MISSING if name == "rainrate" else value)
    yield


@case("C: the station repeats what it measured 25 min ago, and it rains")
def frozen(site):
    before: dict = {}
    site.mark()
    began_s = site.t0
    site.relays["observingconditions"].spoil = measured(
        lambda name, value: 1500.0 if name == "timesincelastupdate" else
        value if name == "timestamp" else before.setdefault(name, value))
    time.sleep(2.5)  # twice polled, so that all is known
    site.weather(rainrate=5.0)
    site.t0 = began_s
    yield


@case("D: every weather value is NaN")
def nan_everywhere(site):
    site.mark()
    site.relays["observingconditions"].spoil = measured(lambda name, value: value if name == "timestamp" else float("nan"))
    yield


@case("E: one IsSafe poll is missing, and the next says false")
def one_poll_missing(site):
    left = [2]  # Starmesh asks twice when the connection breaks

    def spoil(member, raw):
        if member == "issafe" and left[0] > 0:
            left[0] -= 1
            return RESET
        return None
    site.relays["safetymonitor"].spoil = spoil
    site.mark()
    wait("the poll is missed", lambda: left[0] == 0, 10)
    began_s = site.t0
    site.unsafe()
    if site.puts("closeshutter", began_s):  # a single miss need not close; where it does, it counts from there
        site.t0 = began_s
    yield


# -- mount and dome

@case("mount's server hangs, and it is unsafe")
def mount_hangs(site):
    site.relays["telescope"].hang()
    time.sleep(1.0)
    site.unsafe()
    yield


@case("mount's server refuses, and it is unsafe")
def mount_refuses(site):
    site.relays["telescope"].refuse()
    time.sleep(1.0)
    site.unsafe()
    yield


@case("dome's server refuses for 8 s, and it is unsafe")
def dome_refuses(site):
    site.relays["dome"].refuse()
    time.sleep(1.0)
    site.unsafe()
    time.sleep(7.0)
    site.relays["dome"].honest()
    yield


# -- the machine

@case("control process killed (-9), and it is unsafe")
def killed(site):
    os.kill(site.commander(), signal.SIGKILL)
    site.unsafe()
    yield


@case("control process stopped (SIGSTOP), and it is unsafe")
def stopped(site):
    site.stop_process(site.commander())
    site.unsafe()
    yield


@case("disk full, and it is unsafe")
def disk_full(site):
    with exhaust.room(site.disk):
        time.sleep(3.0)
        site.unsafe()
        yield


@case("disk read-only, and it is unsafe")
def disk_read_only(site):
    with exhaust.writing(site.disk):
        time.sleep(3.0)
        site.unsafe()
        yield


@case("control process out of files, and it is unsafe")
def out_of_files(site):
    with exhaust.files(site.commander()):
        time.sleep(1.0)
        site.unsafe()
        yield


@case("database locked by another process, and it is unsafe")
def locked(site):
    import sqlite3
    database = sqlite3.connect(site.database, timeout=20)
    try:
        database.execute("BEGIN EXCLUSIVE")
        time.sleep(3.0)
        site.unsafe()
        yield
    finally:
        database.rollback()
        database.close()
