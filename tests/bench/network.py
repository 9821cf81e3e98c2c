#!/usr/bin/env python3
"""A web node before a network of 20 telescopes of 200 values a second each, with 50 sockets.

The telescopes are published by a plain zenoh program from the golden samples of the bus; the web node is a release process. Needs
the Python of scripts/test: `target/venv/bin/python tests/bench/network.py [TELESCOPES [SOCKETS]]`; see README.md beside this file.
"""

import asyncio
import http.client
import json
import multiprocessing
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from loopback import free_port, wait
from run import BINARY, cpu_s, greatest_mib, pss_mib

PROJECT = pathlib.Path(__file__).resolve().parents[2]
GOLDEN = PROJECT / "common" / "contract" / "golden" / "v1"
KINDS = ["telescope", "camera", "dome", "filterwheel", "focuser", "observingconditions", "safetymonitor", "covercalibrator", "rotator",
         "switch"]
VALUES = 20  # of each device
SITE = "bench"
MEASURED_S = 20.0
PER_ADDRESS = 20  # sockets: the web node takes 40


def sample(name: str) -> dict:
    samples = json.loads((GOLDEN / f"{name}.json").read_text())
    return samples[0] if isinstance(samples, list) else samples


def utc() -> str:
    now = time.time()
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(now)) + f".{int(now % 1 * 1e6):06d}Z"


def publish(endpoint: str, telescopes: int):
    """Each device of each telescope once a second, spread over the second; `value_0` is the time at which it was sent."""
    import zenoh
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    states = {kind: sample(f"{kind}.state") for kind in KINDS}
    night = sample("observatory.night")
    boot, seq, due = "019aa4c2-7b1e-7c3a-9d51-2f6b8e0a4d17", 0, time.monotonic()
    while True:
        seq += 1
        for number in range(telescopes):
            telescope = f"starmesh/v1/{SITE}/t{number:02d}"
            for kind in KINDS:
                state, now = dict(states[kind]), utc()
                readings = {f"Value{n}": {"value": time.time() if n == 0 else seq + 0.125 * n, "unit": "", "at_utc": now}
                            for n in range(VALUES)}
                state.update(boot_id=boot, seq=seq, at_utc=now, period_s=1.0, readings=readings)
                session.put(f"{telescope}/device/{kind}/{kind}/state", json.dumps(state))
            session.put(f"{telescope}/observatory/night/state", json.dumps({**night, "boot_id": boot, "seq": seq, "at_utc": utc()}))
            due += 1.0 / telescopes
            time.sleep(max(0.0, due - time.monotonic()))


async def follow(url: str, host: str, topics: list[str], until: float, delays: list[float], received: list[int]):
    """One socket from an address of this host: how long after it was sent each value arrived, s."""
    import websockets
    async with websockets.connect(url, max_size=None, local_addr=(host, 0)) as socket:
        await socket.send(json.dumps({"op": "sub", "topics": topics}))
        while time.monotonic() < until:
            try:
                text = await asyncio.wait_for(socket.recv(), 3.0)
            except asyncio.TimeoutError:
                continue
            now = time.time()
            received[0] += len(text)
            # every twentieth message is read: this program has no more of the processor
            received[1] += 1
            if received[1] % 20 or '"Value0"' not in text:
                continue
            message = json.loads(text)
            if message["op"] != "delta":
                continue
            for state in message["data"].get("states", {}).values():
                sent = ((state.get("payload") or state).get("readings") or {}).get("Value0")
                if sent:
                    delays.append(now - sent["value"])


def sockets(url: str, count: int, topics_of, seconds: float, result):
    async def all_of_them():
        delays, received, until = [], [0, 0], time.monotonic() + seconds
        await asyncio.gather(*(follow(url, f"127.0.0.{2 + n // PER_ADDRESS}", topics_of(n), until, delays, received) for n in range(count)))
        result.put((delays, received[0]))
    asyncio.run(all_of_them())


def main():
    telescopes, count = (int(text) for text in (sys.argv[1:] + ["20", "50"][len(sys.argv) - 1:])[:2])
    if not BINARY.exists():
        raise SystemExit(f"network: {BINARY} is missing: cargo build --release -p starmesh")
    folder = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-bench-"))
    bus, web = free_port(), free_port()
    (folder / "observatory.toml").write_text(f"""[observatory]
site = "{SITE}"
telescope = "t00"
latitude_deg = -24.6
longitude_deg = -70.4
elevation_m = 2600
[bus]
multicast = false
[web]
listen = "127.0.0.1:{web}"
requests_per_s = 10000
""")
    with open(folder / "web.log", "w") as log:
        node = subprocess.Popen([str(BINARY), "node", "web", "--config", str(folder / "observatory.toml"), "--listen",
                                 f"tcp/127.0.0.1:{bus}"], stdout=log, stderr=log)
    publisher = multiprocessing.Process(target=publish, args=(f"tcp/127.0.0.1:{bus}", telescopes), daemon=True)
    rows = []
    try:
        def network() -> list:
            connection = http.client.HTTPConnection("127.0.0.1", web, timeout=5)
            connection.request("GET", "/api/v1/network")
            return json.loads(connection.getresponse().read())["telescopes"]
        wait("the web node answers", lambda: network() is not None, 30)
        publisher.start()
        wait("every telescope is there", lambda: len(network()) == telescopes, 60)
        time.sleep(5.0)
        connection, took = http.client.HTTPConnection("127.0.0.1", web, timeout=5), []
        for _ in range(1000):
            began = time.monotonic()
            connection.request("GET", "/api/v1/network")
            connection.getresponse().read()
            took.append(1000 * (time.monotonic() - began))
        took.sort()
        rows.append((f"`/api/v1/network` of {telescopes} telescopes, ms", f"median {took[500]:.1f}, p99 {took[990]:.1f}", "p99 < 5"))

        def measure(words: str, number: int, topics_of, aims: tuple[str, str, str]):
            result = multiprocessing.Queue()
            url = f"ws://127.0.0.1:{web}/api/v1/ws"
            client = multiprocessing.Process(target=sockets, args=(url, number, topics_of, MEASURED_S + 4.0, result), daemon=True)
            client.start()
            time.sleep(4.0)
            before, began = cpu_s(node.pid), time.monotonic()
            time.sleep(MEASURED_S - 2.0)
            share = 100 * (cpu_s(node.pid) - before) / (time.monotonic() - began)
            memory = pss_mib(node.pid)
            delays, received = result.get(timeout=60)
            client.join(20)
            rows.append((f"{words}: of one core, %", f"{share:.0f}", aims[0]))
            rows.append((f"{words}: memory, MiB", f"{memory:.0f} (greatest {greatest_mib(node.pid):.0f})", aims[1]))
            if delays:
                delays.sort()
                p95 = 1000 * delays[int(0.95 * len(delays))]
                rows.append((f"{words}: published to received, ms", f"median {1000 * statistics.median(delays):.0f}, p95 {p95:.0f} "
                             f"of {len(delays)}; {received / MEASURED_S / 1e6:.1f} MB/s", aims[2]))
        measure("no socket", 0, lambda n: [], ("-", "-", "-"))
        measure(f"{count} pages of one telescope each", count,
                lambda n: ["net", "alerts", f"tel/{SITE}/t{n % telescopes:02d}"], ("< 40", "< 150", "p95 < 200"))
        measure(f"{count} sockets of all telescopes each", count,
                lambda n: [f"tel/{SITE}/t{number:02d}" for number in range(telescopes)], ("< 40", "< 150", "p95 < 200"))
    finally:
        publisher.kill() if publisher.pid else None
        node.terminate()
        node.wait(20)
    print("| work | Starmesh | to reach |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(f"folder: {folder}")


if __name__ == "__main__":
    os.chdir(PROJECT)
    main()
