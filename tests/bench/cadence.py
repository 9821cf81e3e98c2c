#!/usr/bin/env python3
"""10,000 consecutive exposures of 1 s: is each one file with a complete header, once?

Real nodes as processes on the simulated observatory at 20 times the speed of the sky (CADENCE_SPEED), some 25 minutes; see
README.md beside this file. `python3 tests/bench/cadence.py [FRAMES]`
"""

import contextlib
import json
import os
import pathlib
import sqlite3
import sys
import time

from run import BINARY, greatest_mib, telescope

SPEED = float(os.environ.get("CADENCE_SPEED", "20"))
SIZE_PX = 256
BLOCK, CARD = 2880, 80


def stored(path: pathlib.Path) -> list[tuple[str, int, str, dict]]:
    if not path.exists():
        return []
    with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30)) as database:
        rows = database.execute("SELECT frame_id, complete_hdr, file, frame FROM images").fetchall()
    return [(id, complete, file, json.loads(frame)) for id, complete, file, frame in rows]


def keywords(path: pathlib.Path) -> set[str]:
    """Those of the primary header."""
    found = set()
    with open(path, "rb") as file:
        while block := file.read(BLOCK):
            for at in range(0, BLOCK, CARD):
                keyword = block[at:at + 8].decode("ascii").strip()
                if keyword == "END":
                    return found
                found.add(keyword)
    raise SystemExit(f"cadence: {path} has no END")


def main():
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    if not BINARY.exists():
        raise SystemExit(f"cadence: {BINARY} is missing: cargo build --release --workspace")
    rows = [("open", {}), ("object", {"object": "Fast", "alt": 70.0, "az": 90.0, "exptime": 1.0, "n": wanted})]
    began = time.monotonic()
    with telescope(speed=SPEED, rows=rows, size_px=SIZE_PX, robotic=True) as rig:
        database = rig.folder / "archive.db"
        database = next(iter(rig.folder.rglob("archive.db")), database)
        seen, moved = [], time.monotonic()
        while not (len(seen) >= wanted and all(complete for _, complete, _, _ in seen)):
            time.sleep(5.0)
            database = next(iter(rig.folder.rglob("archive.db")), database)
            before, seen = len(seen), stored(database)
            moved = time.monotonic() if len(seen) != before else moved
            if time.monotonic() - moved > 120.0:
                break
        seconds = time.monotonic() - began
        memory = {role: greatest_mib(rig.processes[role].pid) for role in ("device", "observatory", "archive")}
    files = {path for path in rig.folder.rglob("*.fits")}
    named = [path for path in files if any(str(path).endswith(file) for file in (seen[0][2],))] if seen else []
    root = pathlib.Path(str(named[0])[: -len(seen[0][2])]) if named else rig.folder
    missing = [file for _, _, file, _ in seen if not (root / file).exists()]
    incomplete = sum(not complete for _, complete, _, _ in seen)
    without = sum("AIRMASS" not in keywords(root / file) for _, _, file, _ in seen if file not in missing)
    starts = sorted(frame["started_utc"] for _, _, _, frame in seen)
    doubled = len(seen) - len({id for id, _, _, _ in seen}) + len(starts) - len(set(starts))
    print("| what | found | to reach |\n|---|--:|--:|")
    print(f"| frames in the database | {len(seen)} | {wanted} |")
    print(f"| files | {len(files)} | {wanted} |")
    print(f"| frames without their file, doubled | {len(missing)}, {doubled} | 0, 0 |")
    print(f"| headers not complete; without AIRMASS | {incomplete}; {without} | 0; 0 |")
    print(f"| greatest resident memory, MiB | {', '.join(f'{role} {mib:.0f}' for role, mib in memory.items())} | |")
    print(f"| seconds, at {SPEED:g} times the speed of the sky | {seconds:.0f} | |")
    good = len(seen) == len(files) == wanted and not (missing or incomplete or without or doubled)
    print(f"folder: {rig.folder}")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
