"""The kinds of rig that cases ask for."""

import pathlib
import shutil
import subprocess
import tempfile

from rig import NODES, Rig
from wall_clock import WallClock

DISK_MIB = 48


class WallRig(Rig):
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


def make(flavour: str, binary: str, name: str) -> Rig:
    """A rig that has not started its nodes yet."""
    if flavour == "plain":
        return Rig(binary, name)
    if flavour == "wall":
        return WallRig(binary, name)
    if flavour == "roof":
        return Rig(binary, name, dome='close_with_mount = "parked_within_s"\nparked_within_s = 6.0\n')
    if flavour == "slave":
        return Rig(binary, name, dome='follow = "slave"\n')
    if flavour == "long":
        # a turn is given up after 20 s, the least that a simulated sky allows
        return Rig(binary, name, dome="slit = { timeout_s = 10.0 }\n", exposure_s=12.0)
    if flavour == "up":
        from upright import UpRig
        return UpRig(binary, name)
    if flavour == "network":
        from network import NetworkRig
        return NetworkRig(binary, name)
    raise ValueError(f"there is no rig called {flavour!r}")
