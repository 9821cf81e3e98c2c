"""One site of either system with faults in front of its devices, and how one injection is measured on it."""

import dataclasses
import datetime
import http.client
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "bench"))

import systems
from loopback import fetch, wait
from relay import AlpacaRelay

EXPOSURE_S = 5.0
DISK_MIB = 256
RELAYED = ["safetymonitor", "observingconditions", "telescope", "dome"]
FAIR = {"humidity": 60.0, "rainrate": 0.0}  # what the simulators say at the start


class FaultSite(systems.Site):
    """The simulators, a relay of our own before each device that decides, the program, and a small disk for it."""

    exposures = {"exptime": EXPOSURE_S}
    period_s = 1.0
    ending = staticmethod(systems.kill)

    def __init__(self, program, folder, ends):
        super().__init__(program, folder, ends)
        self.ends.callback(shutil.rmtree, self.folder, ignore_errors=True)
        self.relays = {kind: AlpacaRelay("127.0.0.1", f"127.0.0.1:{self.alpaca}") for kind in RELAYED}
        for relay in self.relays.values():
            self.ends.callback(relay.stop)
        self.disk = self.folder / "disk"
        self.disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", self.disk], check=True)
        self.ends.callback(subprocess.run, ["umount", "--lazy", self.disk], check=False)
        self.t0, self.stopped = 0.0, None

    def start(self):
        super().start()
        self.exposes(180.0)
        self.polled_at_start = self.polled() if self.program is systems.predecessor else set()

    def server(self, kind: str) -> str:
        return self.relays[kind].address if kind in RELAYED else super().server(kind)

    @property
    def database(self) -> pathlib.Path:
        """What it writes telemetry to."""
        return self.disk / ("data/archive.db" if self.program is systems.starmesh else "assets/logs/sim.db")

    def commander(self) -> int:
        """The process that judges and commands: the observatory node, or the predecessor's main process."""
        if self.program is systems.predecessor:
            return self.leader
        for pid in systems.session(self.leader):
            words = pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            if words[1:3] == [b"node", b"observatory"]:
                return pid
        raise SystemExit("there is no observatory node")

    def mark(self):
        self.t0 = time.time()

    def unsafe(self):
        self.t0 = self.set_safe(False)

    def weather(self, **values: float):
        """What the simulated station measures from now on, in its own words."""
        names = {"humidity": "Humidity", "rainrate": "RainRate"}
        self.t0 = max(self.set_value(f"observingconditions/0/{name}", **{names[name]: value}) for name, value in values.items())

    def stop_process(self, pid: int):
        os.kill(pid, signal.SIGSTOP)
        self.stopped = pid

    def polled(self) -> set[str]:
        """Properties of which the predecessor has a fresh value; what failed once it polls no more."""
        now = datetime.datetime.now(datetime.UTC)
        kinds = fetch(f"http://127.0.0.1:{self.port}/api/heartbeat")["data"]["polling"]
        return {f"{name} {word}" for devices in kinds.values() for name, values in devices.items() for word, reading in values.items()
                if reading["datetime"] and (now - datetime.datetime.fromisoformat(reading["datetime"])).total_seconds() < 20.0}

    def restarted_by_hand(self) -> bool:
        """The predecessor's operator clears its errors and turns its switch; false if it needs a new process."""
        if self.program is not systems.predecessor:
            return False
        try:
            fetch(f"http://127.0.0.1:{self.port}/api/heartbeat")
            time.sleep(systems.ERROR_TREE_S)
            systems.restart_watchdog(f"http://127.0.0.1:{self.port}/api")
            if not self.polled_at_start <= self.polled():
                return False
            systems.begin_night(self)
            self.exposes(60.0)
            return True
        except (SystemExit, OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
            return False

    def heal(self):
        """Honest servers, a fair sky, and nobody stopped."""
        for relay in self.relays.values():
            relay.honest()
        self.set_safe(True)
        self.weather(**FAIR)
        if self.stopped:
            os.kill(self.stopped, signal.SIGCONT)
            self.stopped = None

    def is_closed(self) -> bool:
        return self.get("dome/0/shutterstatus") == 1

    def exposes(self, limit_s: float, since_s: float | None = None):
        """Waits until the dome is open, the mount tracks, and an exposure has begun since then."""
        since_s = time.time() if since_s is None else since_s
        wait("dome open and exposing", lambda: self.get("dome/0/shutterstatus") == 0 and self.get("telescope/0/tracking")
             and self.puts("startexposure", since_s), limit_s, 0.25)


@dataclasses.dataclass
class Outcome:
    """What the simulators saw of one injection; `None` is "not within the limit"."""

    took_s: float | None = None
    closed: bool = False
    went_on_s: float | None = None
    not_run: str = ""

    @property
    def never_closed(self) -> bool:
        return self.took_s is None and not self.closed and self.went_on_s is not None


def inject(run, site: FaultSite, limit_s: float, heal_s: float) -> Outcome:
    """One injection into a night at work; `run(site)` breaks one thing, yields, and heals what `site.heal` does not."""
    outcome = Outcome()
    site.exposes(60.0)
    time.sleep(2.0)
    scenario = run(site)
    try:
        next(scenario)
        while time.time() < site.t0 + limit_s:
            if first := site.puts("closeshutter", site.t0):
                outcome.took_s = first[0] - site.t0
                break
            time.sleep(0.1)
        if outcome.took_s is not None:
            # the simulated shutter takes no time; what follows may still open it again
            time.sleep(3.0)
        outcome.closed = site.is_closed()
    finally:
        for _ in scenario:
            pass
        site.heal()
    healed_s = time.time()
    try:
        site.exposes(heal_s, healed_s)
        outcome.went_on_s = time.time() - healed_s
    except SystemExit:
        pass
    return outcome
