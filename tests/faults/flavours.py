"""The kinds of rig that cases ask for."""

import os
import pathlib
import shutil
import subprocess
import tempfile

from rig import NODES, Rig

FAKETIME = pathlib.Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1")
DISK_MIB = 48


class WallRig(Rig):
    """On the machine's own clock, which libfaketime can shift for each node, with its data on a small disk."""

    def __init__(self, binary: str, name: str):
        if not FAKETIME.exists():
            found = sorted(pathlib.Path("/usr/lib").rglob("libfaketimeMT.so.1"))
            if not found:
                raise FileNotFoundError("libfaketime is missing: apt-get install faketime (scripts/setup test does)")
        self.library = FAKETIME if FAKETIME.exists() else found[0]
        disk = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-faults-disk-"))
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", disk], check=True)
        self.disk = disk
        self.shifts = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-faults-clock-"))
        for node in NODES:
            (self.shifts / node).write_text("+0\n")
        (disk / "data").mkdir()
        super().__init__(binary, name, real_clock=True, data=disk / "data", disk_min_gb=0.002)

    def start(self, node: str, env: dict | None = None, limits: list[str] | None = None):
        faked = {"LD_PRELOAD": str(self.library), "FAKETIME_TIMESTAMP_FILE": str(self.shifts / node),
                 "FAKETIME_DONT_FAKE_MONOTONIC": "1", "FAKETIME_CACHE_DURATION": "1"}
        super().start(node, {**faked, **(env or {})}, limits)

    def jump(self, node: str, seconds: int):
        """Takes effect within a second."""
        part = self.shifts / f"{node}.part"
        part.write_text(f"{seconds:+d}\n")
        os.replace(part, self.shifts / node)

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
    if flavour == "up":
        from upright import UpRig
        return UpRig(binary, name)
    if flavour == "network":
        from network import NetworkRig
        return NetworkRig(binary, name)
    raise ValueError(f"there is no rig called {flavour!r}")
