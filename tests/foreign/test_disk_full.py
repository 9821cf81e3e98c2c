"""Small real disks that fill up: what warns, what stops, what waits, and that nothing is lost when there is room again.

Hardware: PyPI alpaca-simulators, whose frames have 2.1 MB. Judges: astropy, and the frames that were announced.
"""

import contextlib
import hashlib
import pathlib
import subprocess
import time

import numpy as np
import pytest
from astropy.io import fits
from bus_subscriber import BusSubscriber
from site_under_test import PREFIX, Record, Site, observing

ALERTS = f"{PREFIX}/observatory/alerts/state"
# the folder of images has room for some 10 frames, that of the data for some 25 more than its limit leaves
IMAGES_MB, DATA_MB, LEAST_GB, WARN_GB = 24, 100, 0.045, 0.010
FRAMES = 60


@contextlib.contextmanager
def tmpfs(folder: pathlib.Path, size: str):
    """A file system of its own; mounting needs root, as in the tests of networks."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def ids(newest: dict) -> set[str]:
    """The ids of the alerts whose cause is there, of whatever node."""
    found = set()
    for key, payload in newest.items():
        if "alert" in key and isinstance(payload, dict):
            found |= {alert["id"] for alert in payload.get("alerts", []) if "returned_utc" not in alert}
    return found


def announced(subscriber: BusSubscriber) -> dict[str, str]:
    return {payload["id"]: payload["sha256"] for key, payload in list(subscriber.received) if key.endswith("/frame")}


class DiskRecord(Record):
    taken_when_stopped: int
    taken_later: int
    alerts_when_stopped: set
    frames: dict


@pytest.fixture(scope="module")
def night(starmesh, catalogue, tmp_path_factory):
    folder = tmp_path_factory.mktemp("disk")
    config = f"[archive]\ndisk_warn_gb = {WARN_GB}\n"
    with tmpfs(folder / "images", f"{IMAGES_MB}m") as images, tmpfs(folder / "data", f"{DATA_MB}m"):
        site = Site(starmesh, folder, catalogue, config=config)
        file = folder / "observatory.toml"
        file.write_text(file.read_text().replace("[safety]\n", f"[safety]\ndisk_free_min_gb = {LEAST_GB}\n"))
        record = DiskRecord()
        record.site = site
        with observing(record):
            site.put("safetymonitor/0/issafe", IsSafe="true")
            site.schedule([("calibration", {"exptime": [1.0], "n": [FRAMES]})], seconds=600)
            site.start_nodes()
            subscriber = record.subscriber = BusSubscriber(site.endpoint)
            seen: set[str] = set()

            def alert(name: str):
                def raised(newest: dict) -> bool:
                    seen.update(ids(newest))
                    return any(one.startswith(name) for one in ids(newest))
                return raised

            subscriber.wait_for("it warns before the folder is full", alert("archive/disk-low"), 90)
            subscriber.wait_for("frames cannot be stored", alert("archive/frame"), 120)
            subscriber.wait_for("the data folder has too little room", alert("disk/data"), 180)
            end = time.monotonic() + 90
            while not settled(subscriber, 12.0):
                assert time.monotonic() < end, "exposing does not stop"
            record.taken_when_stopped = len(announced(subscriber))
            record.alerts_when_stopped = ids(subscriber.newest)
            # room is made, as the operator does who gives it a larger disk
            subprocess.run(["mount", "-o", "remount,size=400m", str(images)], check=True)
            subscriber.wait_for("all frames are taken", lambda _: len(announced(subscriber)) >= FRAMES, 300)
            record.frames = announced(subscriber)
            subscriber.wait_for("all are stored", lambda _: len(site.fits()) >= len(record.frames), 120)

            def complete(_) -> bool:
                stored = [payload for key, payload in list(subscriber.received) if key == f"{PREFIX}/archive/stored"]
                return {payload["frame"] for payload in stored if payload["header_complete"]} >= set(record.frames)

            subscriber.wait_for("all headers are complete", complete, 60)
            end = time.monotonic() + 120
            while left := {one for one in ids(subscriber.newest) if one.startswith(("archive/frame", "disk/", "archive/disk-low"))}:
                assert time.monotonic() < end, f"{left} stay: " + str({k: v for k, v in subscriber.newest.items() if "alerts" in k})
                time.sleep(0.5)
            record.files = {header["FRAMEID"]: sha256(data) for header, data in map(content, site.fits())}
            record.count = len(site.fits())
    yield record


def settled(subscriber: BusSubscriber, seconds: float) -> bool:
    """Nothing was announced for so long."""
    count, until = len(announced(subscriber)), time.monotonic() + seconds
    while time.monotonic() < until:
        if len(announced(subscriber)) != count:
            return False
        time.sleep(0.2)
    return True


def content(path: pathlib.Path) -> tuple[fits.Header, np.ndarray]:
    with fits.open(path, checksum=True, memmap=False) as hdus:
        return hdus[0].header.copy(), hdus[0].data.copy()


def sha256(image: np.ndarray) -> str:
    return hashlib.sha256(image.astype("<u2").tobytes()).hexdigest()


def test_exposing_stops_before_the_spool_is_full(night):
    assert night.taken_when_stopped < FRAMES, "there was room for all, which shows nothing"
    raised = {one.split("/")[0] + "/" + one.split("/")[1] for one in night.alerts_when_stopped if "/" in one}
    assert {"archive/disk-low", "archive/frame"} <= raised and any(one.startswith("disk/data") for one in night.alerts_when_stopped), raised


def test_every_frame_is_in_one_file_with_its_pixels(night):
    assert night.count == len(night.frames) >= FRAMES
    assert night.files == night.frames
