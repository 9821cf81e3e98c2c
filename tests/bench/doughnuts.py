#!/usr/bin/env python3
"""Defocused stars: ours and SEP on the same frames, one after the other.

    cargo build --release -p imaging --example bench_doughnuts
    target/venv/bin/pip install sep && target/venv/bin/python tests/bench/doughnuts.py
"""

import pathlib
import statistics
import subprocess
import tempfile
import time

import numpy
import sep

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIDE, RUNS = 2048, 9


def timed_ms(work) -> tuple[str, object]:
    times, result = [], None
    for _ in range(RUNS):
        began = time.perf_counter()
        result = work()
        times.append(1000.0 * (time.perf_counter() - began))
    return f"{min(times):.0f} ({statistics.median(times):.0f})", result


def objects(image):
    sky = sep.Background(image)
    flat = image - sky
    return flat, sep.extract(flat, 3.0, err=sky.globalrms)


def with_radius(image):
    flat, found = objects(image)
    return sep.flux_radius(flat, found["x"], found["y"], 6.0 * found["a"], 0.5, normflux=found["flux"])


def main():
    with tempfile.TemporaryDirectory() as folder:
        print(subprocess.run([ROOT / "target/release/examples/bench_doughnuts", folder], check=True, text=True,
                             capture_output=True).stdout)
        print(f"SEP {sep.__version__}, ms, best (median) of {RUNS} runs: background and extract (objects), and with radius")
        for diameter in (20, 30, 40, 50):
            counts = numpy.fromfile(pathlib.Path(folder, f"{diameter}.u16"), dtype="<u2").reshape(SIDE, SIDE)
            plain, (_, found) = timed_ms(lambda: objects(counts.astype(numpy.float32)))
            whole, _ = timed_ms(lambda: with_radius(counts.astype(numpy.float32)))
            print(f"{diameter:8d}   {plain:14} {len(found):5d} objects   {whole}")


if __name__ == "__main__":
    main()
