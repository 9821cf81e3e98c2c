"""One telescope as real processes: simulator, two device nodes (the dome's is a process of its own), observatory,
archive, web. The harness supervises them as systemd would, and only ends what it started."""

import contextlib
import datetime
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "python"))

from ports import free_port
from relay import AlpacaRelay
from wire import Late, Wire, arrived_s, wait

SITE, TELESCOPE = "faults", "alpha"
PREFIX = f"starmesh/v1/{SITE}/{TELESCOPE}"
NODES = ["dome", "hands", "observatory", "archive", "web"]
ROLE = {"dome": "device", "hands": "device"}
EXPOSURE_S, READOUT_S, SHUTTER_S = 3.0, 1.0, 2.0
DWELL_MIN = 0.05
PERMIT_VALID_S = 10.0
# the simulated hardware's own, where a case arms it; it is fed in any case
WATCHDOG_S = 8.0
# allowed ages, s: the monitor's is the default, five periods; the weather's is chosen so that a run is short
MONITOR_AGE_S, WEATHER_AGE_S = 5.0, 6.0


class Harness:
    """`hosts` gives each process its address; `enter` what must stand before its command line to run it there."""

    def __init__(self, binary: str, name: str, real_clock: bool = False, dome: str = "", data: pathlib.Path | None = None,
                 hosts: dict[str, str] | None = None, enter: dict[str, list[str]] | None = None,
                 connect: dict[str, list[str]] | None = None, disk_min_gb: float = 1.0,
                 exposure_s: float = EXPOSURE_S):
        # as its processes name it themselves: `target` may be a link
        self.binary, self.name, self.real_clock = os.path.realpath(binary), name, real_clock
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix=f"starmesh-faults-{name}-"))
        self.configuration = self.folder / "observatory.toml"
        self.data = data or self.folder / "data"
        self.hosts, self.enter, self.connect = hosts or {}, enter or {}, connect
        self.dome, self.sun_max_deg, self.disk_min_gb, self.exposure_s = dome, 90.0, disk_min_gb, exposure_s
        self.processes: dict[str, subprocess.Popen] = {}
        self.stopped: set[str] = set()
        self._subscriber = None
        # logs of a harness in which something failed are kept
        self.keep = False
        self.t0 = 0.0
        self.ports = {node: free_port() for node in NODES}
        self.web_port, self.alpaca_port = free_port(), free_port()
        self.start_simulator()
        self.relays = {kind: AlpacaRelay(self.host("simulator"), self.wire.address)
                       for kind in ("safetymonitor", "observingconditions")}
        self.write_config()
        self.write_schedule()

    def host(self, node: str) -> str:
        return self.hosts.get(node, "127.0.0.1")

    # -- what is written

    def write_config(self):
        clock = "" if self.real_clock else f'[clock]\nsimulator = "http://{self.wire.address}"\n'
        text = f"""[observatory]
site = "{SITE}"
telescope = "{TELESCOPE}"
latitude_deg = -24.6272
longitude_deg = -70.4042
elevation_m = 2635
[folders]
data = "{self.data}"
[bus]
multicast = false
{clock}[safety]
sun_altitude_max_deg = {self.sun_max_deg}
disk_free_min_gb = {self.disk_min_gb}
[schedule]
robotic = true
[spool]
listen = "{self.host('hands')}:0"
[web]
listen = "127.0.0.1:{self.web_port}"
"""
        weather = self.relays["observingconditions"].address
        blocks = [
            ("dome", "dome", self.wire.address, f"permit_valid_s = {PERMIT_VALID_S}\nwatchdog_s = {WATCHDOG_S}\n"
             f'watchdog_action = "feedwatchdog"\n{self.dome}', "dome"),
            ("telescope", "mount", self.wire.address, "settle_s = 0.2\nlimits = { altitude_min_deg = 20.0, meridian_past_min = 15.0 }", "hands"),
            ("camera", "camera", self.wire.address, "", "hands"),
            ("filterwheel", "wheel", self.wire.address, "", "hands"),
            ("focuser", "focuser", self.wire.address, "", "hands"),
            ("safetymonitor", "monitor", self.relays["safetymonitor"].address, f"dwell_min = {DWELL_MIN}", "hands"),
            ("observingconditions", "weather", weather, f"period_s = 1.0\nlimit = [{self.limits()}]", "hands"),
        ]
        for kind, name, server, extra, node in blocks:
            text += f'[[{kind}]]\nname = "{name}"\nserver = "{server}"\nnode = "{node}"\n{extra}\n'
        self.configuration.write_text(text)

    def limits(self) -> str:
        each = [("Humidity", 80.0), ("RainRate", 0.1), ("WindSpeed", 15.0)]
        return ", ".join(f'{{ parameter = "{name}", upper = {upper}, dwell_min = {DWELL_MIN}, '
                         f'max_age_s = {WEATHER_AGE_S} }}' for name, upper in each)

    def write_schedule(self):
        now = datetime.datetime.fromisoformat(self.wire.ask("GET", "/simulator/v1/clock")["utc"])
        # wide enough that a clock that jumps by an hour stays inside
        utc, end = ((now + datetime.timedelta(hours=h)).isoformat() for h in (-3, 24))
        value = {"object": "Long field", "alt": 70.0, "az": 90.0, "exptime": self.exposure_s}
        rows = [("open", {}), ("object", value)]
        lines = [json.dumps({"device_name": "camera", "action_type": action, "action_value": value,
                             "start_time": utc, "end_time": end}) for action, value in rows]
        (self.folder / "schedule.jsonl").write_text("\n".join(lines) + "\n")

    # -- processes

    def spawn(self, name: str, command: list[str], env: dict | None = None, out: int | None = None):
        """`out` takes its lines in the place of its log."""
        with open(self.folder / f"{name}.log", "a") as log:
            log.write(f"=== {time.strftime('%H:%M:%S')} start\n")
            log.flush()
            to = log if out is None else out
            self.processes[name] = subprocess.Popen(
                [*self.enter.get(name, []), *command], stdout=to, stderr=to, stdin=subprocess.DEVNULL,
                env={**os.environ, **(env or {})})

    def start_simulator(self):
        host = self.host("simulator")
        self.wire = Wire(host, self.alpaca_port)
        when = [] if self.real_clock else ["--start", "2026-11-21T08:00:00Z"]
        self.spawn("simulator", [self.binary, "simulator", "--bind", f"{host}:{self.alpaca_port}", "--size-px", "64",
                                 "--shutter-s", str(SHUTTER_S), "--slew-deg-per-s", "90", *when])

        def answers():
            with contextlib.suppress(OSError):
                return self.wire.world()
        wait("the simulator answers", answers, 30)

    def endpoint(self, node: str) -> str:
        return f"tcp/{self.host(node)}:{self.ports[node]}"

    def command(self, node: str, id: str | None = None, listen: str | None = None) -> list[str]:
        """Explicit endpoints only: each node listens where all others know it."""
        id = id or (node if node in ROLE else "main")
        others = self.connect[node] if self.connect else [self.endpoint(n) for n in NODES if n != node]
        connect = [word for endpoint in others for word in ("--connect", endpoint)]
        return [self.binary, "node", ROLE.get(node, node), "--id", id, "--config",
                str(self.configuration), "--listen", listen or self.endpoint(node), *connect]

    def start(self, node: str, env: dict | None = None, limits: list[str] | None = None):
        self.spawn(node, [*(limits or []), *self.command(node)], env)

    def start_all(self):
        for node in NODES:
            self.start(node)

    def mark(self):
        """The moment of the injection."""
        self.t0 = time.time()

    def guarded(self, node: str) -> list[int]:
        """The device node inside the guard process that was started as `node`; empty for nodes without one."""
        process = self.processes[node]
        return [pid for pid in descendants(process.pid) if b"--guarded" in command_line(pid)]

    def loops(self, node: str) -> int:
        """The process whose loops do a node's work."""
        return (self.guarded(node) or [self.processes[node].pid])[0]

    def signal(self, number: signal.Signals, *nodes: str):
        """To all processes of these nodes; an order to end goes to the one that was started."""
        for node in nodes:
            inner = [] if number == signal.SIGTERM else self.guarded(node)
            self.processes[node].send_signal(number)
            for pid in inner:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
            if number == signal.SIGSTOP:
                self.stopped.add(node)
            if number == signal.SIGCONT:
                self.stopped.discard(node)

    def kill(self, *nodes: str):
        """As a power cut would."""
        self.signal(signal.SIGKILL, *nodes)
        self.mark()
        for node in nodes:
            self.stopped.discard(node)
            self.processes[node].wait()

    def kill_guard_process(self, node: str = "dome"):
        """The guard process alone: the device node in it lives on."""
        self.processes[node].kill()
        self.mark()
        self.processes[node].wait()

    def kill_guarded(self, node: str = "dome"):
        """The device node alone: the guard process around it lives on."""
        for pid in wait(f"the device node in {node} runs", lambda: self.guarded(node), 20):
            os.kill(pid, signal.SIGKILL)
        self.mark()

    def term(self, *nodes: str):
        self.signal(signal.SIGTERM, *nodes)
        self.mark()
        for node in nodes:
            self.processes[node].wait(timeout=30)

    def restart(self, *nodes: str):
        for node in nodes:
            self.end(node)
            self.start(node)

    def end(self, name: str):
        process = self.processes[name]
        if process.poll() is None:
            if name in self.stopped:
                process.send_signal(signal.SIGCONT)
                self.stopped.discard(name)
            inner = self.guarded(name)
            process.send_signal(signal.SIGINT if name == "simulator" else signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=15)
            if process.poll() is None:
                process.kill()
                process.wait()
            for pid in inner:
                with contextlib.suppress(ProcessLookupError):
                    if b"--guarded" in command_line(pid):
                        os.kill(pid, signal.SIGKILL)

    def heal(self):
        """Honest devices and all nodes alive: what every case ends with, whatever happened in it."""
        if self._subscriber:
            self._subscriber.close()
            self._subscriber = None
        for relay in self.relays.values():
            relay.honest()
        self.wire.heal()
        self.wire.change("watchdog", limit_s=None)
        for node in NODES:
            if node in self.stopped:
                self.signal(signal.SIGCONT, node)
            if self.processes[node].poll() is not None:
                self.start(node)

    def everybody_is_met(self):
        """Each node listens where the others were told: one that found its address taken at a start has it again."""
        def met(node: str) -> bool:
            with contextlib.suppress(OSError), socket.create_connection((self.host(node), self.ports[node]), timeout=1.0):
                return True
            return False
        # those of `up` listen on free ports
        for node in (node for node in NODES if node in self.processes):
            wait(f"{node} listens at {self.endpoint(node)}", lambda node=node: met(node), 15)

    def stop(self):
        if self._subscriber:
            self._subscriber.close()
        # an observatory that ends closes first, for which it needs the device nodes
        for name in sorted(self.processes, key=lambda n: ("observatory", n, "simulator").index(n)):
            self.end(name)
        for relay in self.relays.values():
            relay.stop()
        if not self.keep:
            shutil.rmtree(self.folder, ignore_errors=True)

    # -- what is seen

    def fresh_subscriber(self):
        """A plain zenoh peer on this harness's bus, which has heard the guard; it ends with the case."""
        from bus_subscriber import BusSubscriber
        if self._subscriber:
            self._subscriber.close()
        self._subscriber = BusSubscriber(self.endpoint("dome"))
        self._subscriber.wait_for("the guard is heard", lambda newest: newest.get(f"{PREFIX}/device/dome/dome/guard"), 20)
        return self._subscriber

    def puts(self, member: str, since: int) -> list[dict]:
        return [put for put in self.wire.puts(since) if put["member"] == member]

    def exposes(self, limit_s: float = 120.0):
        """Waits until the dome is open, the mount tracks and an exposure has just begun.

        Before a fault and after it: how soon a night goes on is measured, not limited, so the time is a generous one. A
        shutter that closed unseen is proven closed after 90 s.
        """
        def exposes():
            world = self.wire.world()
            if world["dome"]["open"] < 1.0 or not world["telescope"]["tracking"]:
                return None
            newest = self.puts("startexposure", max(0, self.wire.last() - 200))[-1:]
            return newest and time.time() - arrived_s(newest[0]) < min(self.exposure_s - 1.0, 3.0) and newest
        return wait("the night goes on: dome open and exposing", exposes, limit_s, 0.1)[-1]

    def sun_rises(self, lead_s: float) -> float:
        """Sets the limit of the Sun so that it crosses it after so long, waits for an exposure; degrees per second."""
        before, began = self.wire.world()["sun_altitude_deg"], time.monotonic()
        time.sleep(3.0)
        altitude_deg = self.wire.world()["sun_altitude_deg"]
        rises_deg_per_s = (altitude_deg - before) / (time.monotonic() - began)
        if rises_deg_per_s <= 0.0:
            raise Late("the Sun does not rise in this night")
        self.sun_max_deg = altitude_deg + rises_deg_per_s * lead_s
        self.write_config()
        self.restart("observatory")
        self.exposes(lead_s)
        return rises_deg_per_s

    def sun_is_down(self):
        self.sun_max_deg = 90.0
        self.write_config()
        self.restart("observatory")

    def phase(self, phase: str):
        """Brings the harness into a phase of its night; it is at work already."""
        if phase in ("opening", "slewing", "closing"):
            self.exposes()
            since = self.wire.last()
            self.wire.change("safety", unsafe=True)
            wait("closeshutter", lambda: self.puts("closeshutter", since), 10)
            if phase == "closing":
                wait("the shutter moves", lambda: 0.2 < self.wire.open_fraction() < 0.8, 10, 0.02)
                self.wire.change("safety", unsafe=False)
                return
            wait("closed", lambda: self.wire.open_fraction() == 0.0, 15)
            since = self.wire.last()
            self.wire.change("safety", unsafe=False)
            if phase == "opening":
                wait("the shutter opens", lambda: 0.2 < self.wire.open_fraction() < 0.8, 40, 0.02)
            else:
                slew = wait("the mount slews", lambda: [
                    put for put in self.wire.puts(since) if put["member"].startswith("slewto")
                    and put["device"] == "telescope"], 40, 0.02)
                time.sleep(max(0.0, arrived_s(slew[0]) + 0.3 - time.time()))
            return
        began = arrived_s(self.exposes())
        if phase == "downloading":
            # from the end of the exposure to the end of the readout and a little beyond
            time.sleep(max(0.0, began + self.exposure_s + 0.3 - time.time()))

    def last_words(self, lines: int = 30) -> str:
        words = []
        for name in ["simulator", "up", *NODES]:
            path = self.folder / f"{name}.log"
            if path.exists():
                words.append(f"--- {path}\n" + "\n".join(path.read_text(errors="replace").splitlines()[-lines:]))
        return "\n".join(words)


def command_line(pid: int) -> bytes:
    """Empty for a process that has ended."""
    with contextlib.suppress(OSError):
        return pathlib.Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def descendants(pid: int) -> list[int]:
    """Children, their children, and so on."""
    parents: dict[int, list[int]] = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, IndexError, ValueError):
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                parents.setdefault(parent, []).append(int(entry.name))
    found, todo = [], [pid]
    while todo:
        children = parents.get(todo.pop(), [])
        found += children
        todo += children
    return found


__all__ = ["Harness", "Late", "Wire", "arrived_s", "free_port", "wait"]
