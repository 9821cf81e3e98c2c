#!/usr/bin/env python3
"""A frame's way from its FITS file to a JPEG for eyes: ours, and the predecessor's, on the same files in the same run.

The predecessor makes blocks of pixels their mean until the longest side is at most 1024 px, takes the limits of astropy's ZScaleInterval
(contrast 0.25) and lets Pillow write a grey JPEG of quality 85; this is done here with the same libraries. Needs numpy, astropy and Pillow
(`pip install astropy pillow`), and the example `bench_picture` as a release build:

    cargo build --release -p picture --example bench_picture
    python3 tests/bench/preview.py [SIDE_PX ...]
"""

import io
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
from astropy.io import fits
from astropy.visualization import ZScaleInterval
from PIL import Image

PROJECT = pathlib.Path(__file__).resolve().parents[2]
BINARY = pathlib.Path(os.environ.get("STARMESH_BENCH_PICTURE", PROJECT / "target/release/examples/bench_picture"))
ROUNDS, RUNS = 6, 5


def make(file: pathlib.Path, side_px: int):
    """A sky with noise and some thousand stars."""
    chance = np.random.default_rng(7)
    sky = chance.normal(1000.0, 25.0, (side_px, side_px))
    shape = np.exp(-((np.mgrid[-7:8, -7:8] / 2.0) ** 2).sum(0))
    for x, y, peak in zip(*chance.integers(8, side_px - 8, (2, 3000)), 10 ** chance.uniform(1.5, 4.6, 3000)):
        sky[y - 7:y + 8, x - 7:x + 8] += peak * shape
    fits.PrimaryHDU(np.clip(sky, 0, 65535).astype(np.uint16)).writeto(file)


def predecessor(file: pathlib.Path) -> bytes:
    with fits.open(file) as hdus:
        data = hdus[0].data
        height, width = data.shape
        block = max(-(-height // 1024), -(-width // 1024))
        if block > 1:
            data = data[:height // block * block, :width // block * block]
            data = data.reshape(height // block, block, width // block, block).mean(axis=(1, 3))
        low, high = ZScaleInterval(contrast=0.25).get_limits(data)
        grey = (np.clip((data - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(grey).save(out, format="JPEG", quality=85)
    return out.getvalue()


def theirs_ms(file: pathlib.Path) -> list[float]:
    took = []
    for _ in range(RUNS):
        began = time.perf_counter()
        predecessor(file)
        took.append((time.perf_counter() - began) * 1000)
    return took


def ours_ms(file: pathlib.Path, *words: str) -> list[list[float]]:
    done = subprocess.run([BINARY, file, str(RUNS), *words], check=True, capture_output=True, text=True)
    return [[float(word) for word in line.split()] for line in done.stdout.splitlines()]


def main():
    print("| frame | predecessor, ms | ours as the predecessor's (zscale), ms | ours as usual (asinh), ms | of it read and shrink, stretch and encode | times faster |")
    print("|---|--:|--:|--:|--:|--:|")
    for side_px in [int(word) for word in sys.argv[1:]] or [2048, 4096]:
        with tempfile.TemporaryDirectory() as folder:
            make(file := pathlib.Path(folder) / "frame.fits", side_px)
            predecessor(file)
            theirs, zscale, usual = [], [], []
            # in turns, so that what else the machine does meets all of them
            for _ in range(ROUNDS):
                theirs += theirs_ms(file)
                zscale += ours_ms(file, "zscale")
                usual += ours_ms(file)
        middle = statistics.median
        parts = " + ".join(f"{middle(run[n] for run in usual):.1f}" for n in (1, 2))
        ours = middle(run[0] for run in usual)
        print(f"| {side_px} x {side_px} | {middle(theirs):.1f} | {middle(run[0] for run in zscale):.1f} | {ours:.1f} | {parts} | {middle(theirs) / ours:.1f} |", flush=True)


if __name__ == "__main__":
    main()
