#!/usr/bin/env python3
"""Kills nodes at random instants of a busy night and counts its frames: what the journal, the FITS files and the
database say is what the simulator exposed, and every wanted frame is there exactly once.

    kill_points.py                  200 kills, as `scripts/proof kills` does
    kill_points.py --kills 2000     as `scripts/proof soak` does

Some telescopes run side by side, each a night of rounds (kill_night.py): a new schedule of a few short rows is put in the
file's place, nodes are killed with SIGKILL while it is worked through and started again, the schedule is replaced, and once
its rows have ended all is counted (kill_count.py). Simulator and dome live through the night.
"""

import argparse
import collections
import os
import pathlib
import random
import signal
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
PROJECT = pathlib.Path(__file__).resolve().parents[2]

from kill_night import Night  # noqa: E402
from run import alone, run_all  # noqa: E402

KILLS_PER_ROUND = 10


class Nights:
    """All telescopes, until so many have been killed."""

    def __init__(self, binary: str, kills: int, harnesses: int, seed: int, limit_s: float, loud: bool):
        self.binary, self.harnesses, self.seed, self.limit_s, self.loud = binary, harnesses, seed, limit_s, loud
        self.left, self.lock = kills, threading.Lock()
        self.wrong: list[str] = []
        self.kills: list[tuple] = []
        self.rounds = self.frames = 0

    def draw(self) -> int:
        with self.lock:
            kills = min(self.left, KILLS_PER_ROUND)
            self.left -= kills
            return kills

    def run(self):
        run_all([threading.Thread(target=self.work, args=(number,), daemon=True) for number in range(self.harnesses)])

    def work(self, number: int):
        time.sleep(number * 0.7)  # processes that start all at once only get into each other's way
        night = None
        try:
            night = Night(self.binary, f"kill{number}", random.Random(f"{self.seed}/{number}"))
            night.start_all()
            while kills := self.draw():
                wrong = night.play(kills, self.limit_s)
                self.note(night, wrong)
                if wrong:
                    return
        except Exception as error:
            self.note(night, [f"round {night.round if night else 0}: {error!r}"])
        finally:
            if night:
                with self.lock:
                    self.kills += night.kills
                    self.frames += night.frames
                night.stop()

    def note(self, night: Night | None, wrong: list[str]):
        with self.lock:
            self.rounds += 1
            if not wrong:
                return
            name = night.name if night else "?"
            self.wrong += [f"{name}: {what}" for what in wrong]
            print("\n".join(f"FAIL {name}: {what}" for what in wrong), flush=True)
            if night:
                night.keep = True
                print(f"     its files are kept in {night.folder}; killed: "
                      + ", ".join(f"{node} {time.strftime('%H:%M:%S', time.localtime(at))}" for node, at, _ in night.kills[-6:]),
                      flush=True)
                if self.loud:
                    print(night.last_words(), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--telescopes", type=int, default=5, help="telescopes next to each other")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=180.0, metavar="S", help="the rows of a round end within")
    parser.add_argument("--quiet", action="store_true", help="without the nodes' last words after a failure")
    arguments = parser.parse_args()
    binary = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "debug" / "starmesh"))
    if not binary.exists():
        print(f"{binary} is missing: cargo build --workspace", file=sys.stderr)
        return 2
    alone()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    began = time.monotonic()
    nights = Nights(str(binary), arguments.kills, arguments.telescopes, arguments.seed, arguments.limit, not arguments.quiet)
    nights.run()
    where = collections.Counter((node, phase) for node, _, phase in nights.kills)
    for (node, phase), count in sorted(where.items()):
        print(f"  {count:5} kills of {node} while {phase}")
    print(f"{len(nights.kills)} kills in {nights.rounds} rounds, {nights.frames} frames counted, each exposed once and kept once; "
          f"{len(nights.wrong)} faults; {time.monotonic() - began:.0f} s, seed {arguments.seed}")
    return 1 if nights.wrong or len(nights.kills) < arguments.kills else 0


if __name__ == "__main__":
    sys.exit(main())
