"""The kinds of harness that cases ask for."""

import datetime
import pathlib
import shutil
import subprocess
import tempfile
import time

from harness import DWELL_MIN, NODES, SITE, Harness, free_port
from wall_clock import WallClock

DISK_MIB = 48
# how often a site's own monitor is asked
SHARED_PERIOD_S = 5.0


class WallHarness(Harness):
    """On the machine's own clock, which libfaketime can shift for each node, with its data on a small disk."""

    def __init__(self, binary: str, name: str):
        disk = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-faults-disk-"))
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", disk], check=True)
        self.disk = disk
        self.shifts = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-faults-clock-"))
        self.clocks = {node: WallClock(self.shifts / node) for node in NODES}
        (disk / "data").mkdir()
        super().__init__(binary, name, real_clock=True, data=disk / "data", disk_min_gb=0.002)

    def start(self, node: str, env: dict | None = None, limits: list[str] | None = None):
        super().start(node, {**self.clocks[node].environment, **(env or {})}, limits)

    def jump(self, node: str, seconds: int):
        """Takes effect within a second."""
        self.clocks[node].jump(seconds)

    def heal(self):
        for node in NODES:
            self.jump(node, 0)
        super().heal()

    def stop(self):
        super().stop()
        subprocess.run(["umount", "--lazy", self.disk], check=False)
        for folder in (self.disk, self.shifts):
            shutil.rmtree(folder, ignore_errors=True)


class SunHarness(WallHarness):
    """A wall harness whose whole world, simulator included, lives in the morning of the site, where the Sun rises."""

    MORNING_UTC_H = 12.0

    def __init__(self, binary: str, name: str):
        now = time.gmtime()
        self.behind_s = int((now.tm_hour + now.tm_min / 60 - self.MORNING_UTC_H) * 3600)
        super().__init__(binary, name)
        for node in NODES:
            self.jump(node, 0)

    def spawn(self, name: str, command: list[str], env: dict | None = None):
        if name == "simulator":
            clock = WallClock(self.shifts / "simulator")
            clock.jump(-self.behind_s)
            env = clock.environment
        super().spawn(name, command, env)

    def start_simulator(self):
        super().start_simulator()
        behind = datetime.timedelta(seconds=self.behind_s)
        all_puts = self.wire.puts

        def puts(since: int = 0):
            """What the simulator noted, at the times of this host."""
            return [{**put, "wall_utc": (datetime.datetime.fromisoformat(put["wall_utc"]) + behind).isoformat()}
                    for put in all_puts(since)]
        self.wire.puts = puts

    def jump(self, node: str, seconds: int):
        self.clocks[node].jump(seconds - self.behind_s)


class SiteHarness(Harness):
    """The safety monitor belongs to the site: a device node of the telescope `shared` asks it each 5 s."""

    def __init__(self, binary: str, name: str):
        self.shared_port = free_port()
        super().__init__(binary, name)

    def write_config(self):
        super().write_config()
        file = self.configuration
        head, *blocks = file.read_text().split("\n[[")
        blocks = [block for block in blocks if not block.startswith("safetymonitor")]
        (self.folder / "shared.toml").write_text(f"""[observatory]
site = "{SITE}"
telescope = "shared"
latitude_deg = -24.6272
longitude_deg = -70.4042
elevation_m = 2635
[folders]
data = "{self.folder / 'shared-data'}"
[bus]
multicast = false
[clock]
simulator = "http://{self.wire.address}"
[[safetymonitor]]
name = "monitor"
server = "{self.relays['safetymonitor'].address}"
period_s = {SHARED_PERIOD_S}
""")
        shared = f'[shared]\nsafetymonitor = ["monitor"]\ndwell_min = {DWELL_MIN}\n'
        file.write_text("\n[[".join([head + "\n" + shared, *blocks]))

    def start_shared(self):
        connect = [word for node in NODES for word in ("--connect", self.endpoint(node))]
        self.spawn("shared", [self.binary, "node", "device", "--id", "main", "--config", str(self.folder / "shared.toml"),
                              "--listen", f"tcp/127.0.0.1:{self.shared_port}", *connect])

    def start_all(self):
        self.start_shared()
        super().start_all()

    def heal(self):
        if self.processes["shared"].poll() is not None:
            self.start_shared()
        super().heal()


def make(flavour: str, binary: str, name: str) -> Harness:
    """A harness that has not started its nodes yet."""
    if flavour == "plain":
        return Harness(binary, name)
    if flavour == "wall":
        return WallHarness(binary, name)
    if flavour == "roof":
        return Harness(binary, name, dome='close_with_mount = "parked_within_s"\nparked_within_s = 6.0\n')
    if flavour == "only":
        return Harness(binary, name, dome='close_with_mount = "parked_only"\nparked_within_s = 6.0\n')
    if flavour == "slave":
        return Harness(binary, name, dome='follow = "slave"\n')
    if flavour == "long":
        # a turn is given up after 20 s, the least that a simulated sky allows
        return Harness(binary, name, dome="slit = { timeout_s = 10.0 }\n", exposure_s=12.0)
    if flavour == "sun":
        return SunHarness(binary, name)
    if flavour == "site":
        return SiteHarness(binary, name)
    if flavour == "up":
        from upright import UpHarness
        return UpHarness(binary, name)
    if flavour == "network":
        from network import NetworkHarness
        return NetworkHarness(binary, name)
    raise ValueError(f"there is no harness called {flavour!r}")
