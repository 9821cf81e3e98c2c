"""What `starmesh check` says of targets behind the horizon of a site, against astropy: random places, windows and walls.

Both sides are given the same orientation of the Earth.
"""

import json
import os
import re
import subprocess

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, solar_system_ephemeris
from astropy.coordinates.erfa_astrom import ErfaAstromInterpolator, erfa_astrom
from astropy.time import Time, TimeDelta
from astropy.utils import iers

# more of them in `scripts/proof foreign`
CASES = int(os.environ.get("SKY_CASES", "200"))
# a file's findings are told up to 200
ROWS_OF_A_FILE = 25
DUT1_S, POLE_ARCSEC = 0.35, (0.2, 0.4)
LATITUDE_DEG, LONGITUDE_DEG, ELEVATION_M = -24.6157, -70.3976, 2518.0
# altitudes of walls every 20 deg of azimuth, from steep to none
WALLS_DEG = [8, 12, 45, 50, 20, 6, 6, 30, 31, 29, 10, 70, 70, 15, 5, 5, 40, 8]
# the check looks every 30 s with a sky that is turned with the Earth for half an hour, good to 0.02 deg (decision 0027)
LOOK_S, GOOD_DEG = 30, 0.02
STEP_S = 10


class Given(iers.IERS):
    """One orientation of the Earth at all times, as the configuration has it."""

    def ut1_utc(self, jd1, jd2=0.0, return_status=False):
        value = np.full(np.shape(getattr(jd1, "jd", jd1)), DUT1_S) * u.s
        return (value, np.zeros(value.shape, int)) if return_status else value

    def pm_xy(self, jd1, jd2=0.0, return_status=False):
        shape = np.shape(getattr(jd1, "jd", jd1))
        x, y = (np.full(shape, part) * u.arcsec for part in POLE_ARCSEC)
        return (x, y, np.zeros(shape, int)) if return_status else (x, y)


@pytest.fixture(scope="module", autouse=True)
def one_earth():
    """The same orientation of the Earth for both sides."""
    with iers.earth_orientation_table.set(Given()), solar_system_ephemeris.set("builtin"):
        yield


def wall_deg(azimuth_deg):
    """The horizon, a straight line between the walls."""
    points = np.arange(len(WALLS_DEG) + 1) * 20.0
    return np.interp(azimuth_deg, points, WALLS_DEG + WALLS_DEG[:1])


def lasting(mask):
    """Where it holds so long, around each moment, that looks every 30 s cannot miss it."""
    side = LOOK_S // STEP_S
    padded = np.pad(mask, side, constant_values=False)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * side + 1).all(axis=1)


def configured(folder):
    points = ", ".join(f"[{20 * n}, {wall}]" for n, wall in enumerate(WALLS_DEG))
    config = folder / "observatory.toml"
    config.write_text(f"""
[observatory]
site = "paranal"
telescope = "callisto"
latitude_deg = {LATITUDE_DEG}
longitude_deg = {LONGITUDE_DEG}
elevation_m = {ELEVATION_M}
dut1_s = {DUT1_S}
polar_x_arcsec = {POLE_ARCSEC[0]}
polar_y_arcsec = {POLE_ARCSEC[1]}

[schedule.check]
moon_distance_min_deg = 0.0

[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
horizon = [{points}]

[[camera]]
name = "main"
server = "10.0.0.5:11111"
telescope = "mount"
""")
    return config


def hidden_by_starmesh(starmesh, folder, rows) -> dict[int, str]:
    """What is told of each row that is hidden, by its place."""
    config, warnings = configured(folder), {}
    for first in range(0, len(rows), ROWS_OF_A_FILE):
        file = folder / "rows.jsonl"
        file.write_text("".join(json.dumps(row) + "\n" for row in rows[first : first + ROWS_OF_A_FILE]))
        command = [starmesh, "check", str(file), "--config", str(config), "--at", "2026-11-01T00:00:00Z"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stdout + done.stderr
        assert not re.search(r": and \d+ more", done.stdout), "findings were left out: fewer rows in a file"
        for line, words in re.findall(r"jsonl:(\d+):\d+: warning: (.*behind the horizon of the site.*)", done.stdout):
            assert first + int(line) - 1 not in warnings, words
            warnings[first + int(line) - 1] = words
    return warnings


def test_targets_behind_the_horizon_are_reported_as_astropy_has_them_in_cases_drawn_from_a_seed(starmesh, tmp_path):
    random = np.random.default_rng(6)
    begin = Time("2026-11-05", scale="utc")
    # whole seconds, which a schedule writes
    start_s = np.round(random.uniform(0, 30 * 86400, CASES))
    length_s = np.round(random.uniform(600, 9000, CASES) / LOOK_S) * LOOK_S
    ra, dec = random.uniform(0, 360, CASES), np.degrees(np.arcsin(random.uniform(-1, 0.9, CASES)))
    start = begin + TimeDelta(start_s, format="sec")
    end = start + TimeDelta(length_s, format="sec")
    rows = [
        {
            "device_name": "main", "action_type": "object", "start_time": start[i].iso[:19], "end_time": end[i].iso[:19],
            "action_value": {"object": f"x{i}", "exptime": 60, "ra": ra[i], "dec": dec[i]},
        }
        for i in range(CASES)
    ]
    warnings = hidden_by_starmesh(starmesh, tmp_path, rows)

    site = EarthLocation.from_geodetic(LONGITUDE_DEG, LATITUDE_DEG, ELEVATION_M)
    steps = (length_s / STEP_S).astype(int) + 1
    of_row = np.repeat(np.arange(CASES), steps)
    after_s = np.concatenate([np.arange(count) * float(STEP_S) for count in steps])
    when = start[of_row] + TimeDelta(after_s, format="sec")
    # nutation from 5 min to 5 min is good to a microarcsecond
    with erfa_astrom.set(ErfaAstromInterpolator(300 * u.s)):
        frame = AltAz(obstime=when, location=site)
        there = SkyCoord(ra[of_row] * u.deg, dec[of_row] * u.deg).transform_to(frame)
    room_deg = there.alt.deg - wall_deg(there.az.deg)
    # across a wall that rises by 3 deg per degree of azimuth so much altitude is the same as 0.02 deg aside
    unsure_deg = GOOD_DEG * (1 + 3.3 / np.maximum(np.cos(there.alt.rad), 0.01))

    seen = {"hidden": 0, "clear": 0, "whole": 0, "parts": 0}
    ends = np.cumsum(steps)
    for i in range(CASES):
        part = slice(ends[i] - steps[i], ends[i])
        room, unsure, at_s = room_deg[part], unsure_deg[part], after_s[part]
        hidden, clear = lasting(room < -unsure), lasting(room > unsure)
        words = warnings.get(i)
        where = f"{rows[i]}: {words}, room {room.min():.3f} to {room.max():.3f} deg"
        assert words or not hidden.any(), where
        assert words is None or not (room > unsure).all(), where
        seen["hidden"] += bool(hidden.any())
        seen["clear"] += words is None
        if words is None:
            continue
        times = [(Time(at, scale="utc") - start[i]).sec for at in re.findall(r"(\S+?)Z", words.split(", at the worst")[0])]
        first, last = (times[0], times[-1]) if times else (np.inf, -np.inf)
        outside = (at_s <= first - LOOK_S) | (at_s >= last + LOOK_S)
        at_turn = np.isin(at_s, np.round(times, -1))
        match re.search(r"of the site (over|until|but from|from \S+ on|from)", words)[1].split():
            case ["over"]:
                assert not clear.any(), where
                seen["whole"] += 1
            case ["until"]:
                assert not clear[at_s <= first - LOOK_S].any() and not hidden[at_turn].any(), where
            case ["from", _, "on"]:
                assert not hidden[at_s <= first - LOOK_S].any() and not clear[at_turn].any(), where
            case ["but", "from"]:
                assert not clear[outside].any() and not hidden[at_turn].any(), where
            case ["from"]:
                assert not hidden[outside].any() and not clear[at_turn].any(), where
        seen["parts"] += bool(times)
        worst = re.search(r"at the worst (-?[\d.]+) deg where the horizon is (-?[\d.]+) deg", words)
        worst_deg = float(worst[1]) - float(worst[2])
        # of the looks; told in tenths of a degree, while the sky turns by an eighth of one from look to look
        slack_deg = 0.1 + 0.125 * (1 + 3.3 / max(np.cos(there.alt.rad[part][room.argmin()]), 0.1))
        assert abs(worst_deg - room.min()) < slack_deg, where
    print(seen)
    share = {kind: count / CASES for kind, count in seen.items()}
    assert share["hidden"] > 0.3 and share["clear"] > 0.15 and share["whole"] > 0.1 and share["parts"] > 0.1, seen
