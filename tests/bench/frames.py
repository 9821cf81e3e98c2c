#!/usr/bin/env python3
"""From a frame that is announced to its WCS and quality on the bus and in its header, and the memory that takes.

Real nodes as processes, release builds, on the simulated observatory; see README.md beside this file. Needs the Python of
scripts/test (eclipse-zenoh): `target/venv/bin/python tests/bench/frames.py [SIDE_PX ...]`
"""

import os
import pathlib
import statistics
import sys
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "python"))

from bus_subscriber import BusSubscriber  # noqa: E402
from run import BINARY, greatest_mib, telescope  # noqa: E402

COUNT = int(os.environ.get("FRAMES_N", "12"))
# long enough that a poll of every device falls within it, so that no header waits for telemetry
EXPOSURE_S = 12.0
PLACE = {"alt": 70.0, "az": 90.0}


class Watch(BusSubscriber):
    """Notes when something was first said of a frame, monotonic s, by topic and frame."""

    def __init__(self, endpoint: str):
        self.times: dict[tuple[str, str], float] = {}
        self.facts: dict[str, dict] = {}
        super().__init__(endpoint)

    def _receive(self, sample):
        now = time.monotonic()
        super()._receive(sample)
        key = str(sample.key_expr)
        payload = self.newest.get(key, {})
        if key.endswith("/frame"):
            self.times.setdefault(("announced", payload["id"]), now)
        # what the dome says of a frame may come before what was measured in it
        elif key.endswith("/facts") and ("measuring_s" in payload or payload.get("reason")):
            self.times.setdefault(("facts", payload["frame"]), now)
            self.facts.setdefault(payload["frame"], payload)
        elif key.endswith("/archive/stored") and payload["header_complete"]:
            self.times.setdefault(("header", payload["frame"]), now)


def measure(side_px: int):
    rows = [("open", {}), ("object", {"object": "Field", **PLACE, "exptime": EXPOSURE_S, "n": COUNT})]
    with telescope(rows=rows, size_px=side_px, robotic=True) as rig:
        subscriber = Watch(f"tcp/127.0.0.1:{rig.bus}")

        def frames(topic: str) -> list[str]:
            return [frame for what, frame in list(subscriber.times) if what == topic]

        try:
            subscriber.wait_for("every frame has facts and header", lambda _: len(frames("facts")) >= COUNT
                                and len(frames("header")) >= COUNT, 120 + 4 * COUNT * EXPOSURE_S)
            memory = {role: greatest_mib(rig.processes[role].pid) for role in ("observatory", "archive", "device")}
        finally:
            subscriber.close()
        after = {topic: sorted(1000 * (subscriber.times[topic, frame] - subscriber.times["announced", frame]) for frame in frames(topic))
                 for topic in ("facts", "header")}
        facts = [subscriber.facts[frame] for frame in frames("facts")]
    unsolved = [fact.get("unsolved") or fact.get("reason") for fact in facts if not fact.get("wcs")]

    def shown(values: list[float]) -> str:
        return f"median {statistics.median(values):.0f}, max {values[-1]:.0f}"

    def row(work: str, figure: str, aim: str):
        print(f"| {work}, {side_px} x {side_px} | {figure} | {aim} |", flush=True)

    aim = "<= 300" if side_px <= 2048 else "-"
    row("announced to WCS and quality on the bus, ms", shown(after["facts"]), aim)
    row("announced to WCS and quality in the header, ms", shown(after["header"]), aim)
    inside = [sorted(1000 * fact[name] for fact in facts if name in fact) for name in ("measuring_s", "solving_s")]
    row("of it measuring and solving; solving alone, ms", "; ".join(shown(values) for values in inside if values), "-")
    row("frames solved", f"{len(facts) - len(unsolved)} of {len(facts)} {unsolved or ''}".strip(), f"{COUNT} of {COUNT}")
    split = ", ".join(f"{role} {mib:.0f}" for role, mib in memory.items())
    row("greatest resident memory, MiB", split, "observatory <= 400" if side_px >= 4096 else "-")


def main():
    if not BINARY.exists():
        raise SystemExit(f"bench: {BINARY} is missing: cargo build --release --workspace")
    print("| work | Starmesh | to reach |\n|---|---|---|", flush=True)
    for side_px in [int(text) for text in sys.argv[1:]] or [2048, 4096]:
        measure(side_px)


if __name__ == "__main__":
    main()
