#!/usr/bin/env python3
"""A transit in a simulated night, by our light curve and by prose's of the very same files; see README.md in this folder.

    scripts/setup proof && cargo build -p starmesh && python3 tests/bench/transit.py [FOLDER]      # five minutes; with FOLDER, what the night wrote stays there

Standard library only: prose (PyPI, MIT) has an environment of its own in target/venv-prose (`scripts/setup proof`), since it needs old versions of
others. Exit code 1 where the two curves do not agree.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

PROJECT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / "tests/foreign"), str(PROJECT / "tests/python")]

from transit_night import DEC_DEG, DEPTH, RA_DEG, Fit, Transit, points  # noqa: E402

STARMESH = os.environ.get("STARMESH_BIN", str(PROJECT / "target/debug/starmesh"))
PYTHON = os.environ.get("STARMESH_PROSE", str(PROJECT / "target/venv-prose/bin/python"))
# as long as the target stands in the east: the more points, the less what prose gains by choosing for this curve
AFTER_MID_MIN = 65.0
# how much the scatters may differ
SHARE = 0.2


def prose(folder: pathlib.Path) -> dict:
    """Its curve of the FITS files as they are."""
    command = [PYTHON, "-B", str(PROJECT / "tests/foreign/prose_curve.py"), str(folder / "images"), str(RA_DEG), str(DEC_DEG)]
    done = subprocess.run(command, env=os.environ | {"HOME": str(folder / "home")}, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def compare(folder: pathlib.Path) -> list[str]:
    """Prints the table; returns in what the curves disagree."""
    transit = Transit(STARMESH, folder, AFTER_MID_MIN, calibration=True)
    try:
        transit.run()
        curve = transit.curve()
    finally:
        transit.stop()
    theirs = prose(folder)
    ours, other = Fit(points(curve)), Fit(theirs["points"])
    print("| | simulated | Starmesh | prose 3.3.4 |\n|---|--:|--:|--:|")
    print(f"| points outside, inside | | {ours.outside}, {ours.inside} | {other.outside}, {other.inside} |")
    print(f"| comparison stars | | {curve['comparison_stars']} | {theirs['comparison_stars']} |")
    print("| frames that calibrate | | 0 | {bias} bias, {darks} dark, {flats} flat |".format(**{kind: len(names) for kind, names in theirs["files"].items()}))
    print(f"| depth, thousandths | {1e3 * DEPTH:.2f} | {1e3 * ours.depth:.2f} +- {1e3 * ours.depth_error:.2f} | "
          f"{1e3 * other.depth:.2f} +- {1e3 * other.depth_error:.2f} |")
    print(f"| scatter outside of the transit, thousandths | {1e3 * photons(curve):.2f} (photons) | {1e3 * ours.scatter:.2f} | {1e3 * other.scatter:.2f} |")
    same_photons = max(ours.depth_error, other.depth_error)
    wrong = {
        f"the scatters differ by more than {SHARE:.0%}": not 1 / (1 + SHARE) <= ours.scatter / other.scatter <= 1 + SHARE,
        "the depths differ by more than twice the larger error": abs(ours.depth - other.depth) > 2 * same_photons,
        "our depth is not the simulated one": abs(ours.depth - DEPTH) > 3 * ours.depth_error,
        "prose did not use every frame of the target": len(theirs["points"]) != len(curve["points"]),
    }
    return [what for what, is_so in wrong.items() if is_so]


def photons(curve: dict) -> float:
    """The error that the points have by their photons."""
    return sum(point["flux_error"] for point in curve["points"]) / len(curve["points"])


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="starmesh-transit-") as temporary:
        folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else temporary)
        folder.mkdir(parents=True, exist_ok=True)
        wrong = compare(folder)
    for what in wrong:
        print(f"WRONG: {what}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
