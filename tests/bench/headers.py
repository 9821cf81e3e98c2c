#!/usr/bin/env python3
"""Headers of 2048 x 2048 px completed: ours, and what any program with astropy needs to write as many keywords into the same
files.

Runs `cargo bench -p node-archive --bench headers`, which keeps 20 of its frames as they were before, and updates those with
astropy, as the predecessor does after it has interpolated the telemetry (which is not counted here). Needs the Python of
scripts/test: `target/venv/bin/python tests/bench/headers.py`
"""

import os
import pathlib
import re
import statistics
import subprocess
import tempfile
import time

from astropy.io import fits

PROJECT = pathlib.Path(__file__).resolve().parents[2]


def astropy_ms(path: pathlib.Path, count: int) -> float:
    began = time.monotonic()
    with fits.open(path, mode="update") as file:
        for n in range(count):
            file[0].header[f"KEY{n}"] = (0.125 * n, "[unit] a value from the telemetry")
    return 1000 * (time.monotonic() - began)


def main():
    with tempfile.TemporaryDirectory(prefix="starmesh-bench-") as folder:
        command = ["cargo", "bench", "-p", "node-archive", "--bench", "headers", "--locked", "--quiet"]
        printed = subprocess.run(command, cwd=PROJECT, env={**os.environ, "BENCH_FOLDER": folder}, check=True, text=True,
                                 stdout=subprocess.PIPE).stdout
        ours_ms, keywords = re.search(r"headers: ([0-9.]+) ms each, (\d+) keywords", printed).groups()
        took = [astropy_ms(path, int(keywords)) for path in sorted(pathlib.Path(folder).glob("*.fits"))]
    theirs_ms = statistics.median(took)
    print("| headers of 2048 x 2048 px, only the header changes | ms each | frames/s | to reach |\n|---|--:|--:|--:|")
    print(f"| Starmesh, telemetry from its database, {keywords} keywords | {ours_ms} | {1000 / float(ours_ms):.0f} | 300 |")
    print(f"| astropy, as many keywords, without any telemetry | {theirs_ms:.1f} | {1000 / theirs_ms:.0f} | |")
    print(f"| ratio | {theirs_ms / float(ours_ms):.1f} | | 20 |")


if __name__ == "__main__":
    main()
