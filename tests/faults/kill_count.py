"""Counts a round of a night with kills: what the journal, the database and the FITS files say is what the simulator
exposed. The rule, of which nothing is left out for a kill:

- Of each row exactly the frames that it asks for are in the database, of the row without an end any number; frames that
  the journal says do not count (a field lost, a dome in the way) are not among them.
- The journal counts exactly the frames that are stored, each once; each row ended once, and as finished.
- The FITS files are exactly those that the database names, each whole: its pixels have the hash of the frame.
- Each stored frame is one start of an exposure in the simulator's log. A start without a frame was cut off: aborted, or
  its camera's node was killed after the start and before its disk had the frame. No other node's death excuses a start.
"""

import collections
import contextlib
import datetime
import hashlib
import json
import pathlib
import re
import sqlite3

from harness import TELESCOPE, arrived_s

SPEED = 4.0
EXPOSURE_S, READOUT_S = 1.0, 1.0
# frames of a row that must be taken, by the word by which the frames of a round are told apart
WANTED = {"first": 3, "dark": 2, "second": 3, "late": 2}
# a start in the log and the start of a frame that the camera tells are one, sky s; two starts are further apart
SAME_START_S = 0.8
# a frame is on the spool's disk so long after its readout, machine s
TO_DISK_S = 2.0
# FITS: blocks of header and data, and cards of a header
BLOCK, CARD = 2880, 80


class Count:
    """One round of a night, from the simulator's command number `first_put` on."""

    def __init__(self, night, first_put: int):
        self.night, self.first_put, self.visit = night, first_put, str(night.round)
        # that are stored and agree with all else, once `faults` has found nothing
        self.frames = 0

    def journal(self) -> list[dict]:
        path = self.night.data / f"journal-{TELESCOPE}.jsonl"
        lines = path.read_text(errors="replace").splitlines() if path.exists() else []
        read = []
        for line in lines:
            with contextlib.suppress(ValueError):  # half a line is what a kill leaves
                read.append(json.loads(line))
        return read

    def ended(self) -> list[dict]:
        return [line for line in self.journal() if line["is"] == "ended"]

    def stored(self) -> list[dict]:
        """Rows of the archive's database, by the frame's own words."""
        uri = f"file:{self.night.data / 'archive.db'}?mode=ro"
        with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=5)) as database:
            rows = database.execute("SELECT frame_id, file, frame FROM images").fetchall()
        return [{**json.loads(frame), "id": id, "file": file} for id, file, frame in rows]

    def faults(self) -> list[str]:
        """What does not agree; nothing is right."""
        try:
            stored = self.stored()
        except sqlite3.Error as error:
            return [f"the database cannot be read: {error}"]
        mine = [frame for frame in stored if frame["purpose"].get("metadata", {}).get("visit") == self.visit]
        self.frames = len(mine)
        wrong = self.wanted(mine) + self.files(stored, mine) + self.exposed(mine)
        return [f"round {self.visit}: {what}" for what in wrong]

    def wanted(self, mine: list[dict]) -> list[str]:
        """Every row has its frames, and the journal says the same."""
        wrong, journal = [], self.journal()
        spoilt = {line["frame"] for line in journal if line["is"] in ("aside", "astray")
                  or (line["is"] == "hidden" and not line["counts"])}
        words = collections.Counter(frame["purpose"]["metadata"]["word"] for frame in mine if frame["id"] not in spoilt)
        wrong += [f"{words[word]} frames of {word!r} are stored, wanted {n}" for word, n in WANTED.items() if words[word] != n]
        taken = collections.Counter(line["frame"] for line in journal if line["is"] == "taken")
        wrong += [f"the journal counts frame {frame} {times} times" for frame, times in taken.items() if times > 1]
        rows = {line["frame"]: line["row"] for line in journal if line["is"] in ("intended", "aside")}
        ids = {frame["id"] for frame in mine}
        own_rows = {rows.get(id) for id in ids}
        counted = {frame for frame in taken if rows.get(frame) in own_rows} - spoilt
        if counted != ids - spoilt:
            wrong.append(f"the journal counts {sorted(counted - ids)} that are not stored, and not "
                         f"{sorted(ids - spoilt - counted)} that are")
        ended = [line for line in journal if line["is"] == "ended"]
        wrong += [f"a row ended as {line['status']}: {line['detail']}" for line in ended if line["status"] != "finished"]
        twice = [row for row, times in collections.Counter(line["row"] for line in ended).items() if times > 1]
        return wrong + [f"row {row} ended more than once" for row in twice]

    def files(self, stored: list[dict], mine: list[dict]) -> list[str]:
        """The files are those of the database; those of this round are whole."""
        images = self.night.folder / "images"
        there = {str(path.relative_to(images)) for path in images.rglob("*.fits")}
        named = collections.Counter(frame["file"] for frame in stored)
        wrong = [f"the file {name} is of {times} frames" for name, times in named.items() if times > 1]
        wrong += [f"the file {name} is of no frame of the database" for name in sorted(there - set(named))]
        wrong += [f"the file {name} is missing" for name in sorted(set(named) - there)]
        for frame in mine:
            if frame["file"] in there and (digest := pixels_sha256(images / frame["file"])) != frame["sha256"]:
                wrong.append(f"the file {frame['file']} has pixels of the hash {digest}, wanted {frame['sha256']}")
        return wrong

    def exposed(self, mine: list[dict]) -> list[str]:
        """Every frame is one start in the simulator's log, and a start without a frame was cut off."""
        wrong, puts = [], self.night.wire.puts(self.first_put)
        starts = [put for put in puts if put["member"] == "startexposure" and put["error"] == 0]
        aborts = [arrived_s(put) for put in puts if put["member"] in ("abortexposure", "stopexposure")]
        left = list(starts)
        for frame in mine:
            its = [put for put in left if is_one(utc_s(put["sky_utc"]), utc_s(frame["started_utc"]))]
            if its:
                left.remove(its[0])
            else:
                wrong.append(f"frame {frame['id']} of {frame['started_utc']} was never exposed")
        for put in left:
            # on a busy machine a readout takes seconds; it is over when the next exposure begins, and on disk soon after
            began, sky_s = arrived_s(put), utc_s(put["sky_utc"])
            after = [arrived_s(next) for next in starts if next["seq"] > put["seq"]]
            until = max(began + (EXPOSURE_S + READOUT_S) / SPEED, min(after, default=began + 10.0)) + TO_DISK_S
            its_deaths = [in_spool for at, in_spool in self.night.deaths if began - 0.5 <= at <= until]
            if any(is_one(sky_s, begun) for in_spool in its_deaths for begun in in_spool):
                wrong.append(f"the exposure of {put['sky_utc']} was on the disk of its camera's node, and is no frame")
            elif not its_deaths and not any(began - 0.5 <= at <= until for at in aborts):
                wrong.append(f"the exposure of {put['sky_utc']} is no frame, and nobody was killed for it")
        return wrong


def spooled(folder: pathlib.Path) -> list[float]:
    """When the frames began that a spool has whole, sky s: those that its node may not lose by dying."""
    begun = []
    for path in folder.glob("*.json"):
        with contextlib.suppress(FileNotFoundError):  # released meanwhile by nobody: its node is dead
            begun.append(utc_s(json.loads(path.read_text())["frame"]["started_utc"]))
    return begun


def pixels_sha256(path: pathlib.Path) -> str:
    """Hash of a file's pixels as they were in the spool: unsigned 16-bit integers, least byte first. FITS keeps them less
    32,768 and highest byte first."""
    with open(path, "rb") as file:
        header = b""
        while b"END" + b" " * 77 not in [header[at:at + CARD] for at in range(max(0, len(header) - BLOCK), len(header), CARD)]:
            block = file.read(BLOCK)
            if len(block) < BLOCK:
                return "none: its header has no end"
            header += block
        cards = dict(re.findall(r"(NAXIS1|NAXIS2|BITPIX|BZERO) *= +(-?[0-9]+)", header.decode("ascii", "replace")))
        if (cards.get("BITPIX"), cards.get("BZERO")) != ("16", "32768"):
            return f"none: its pixels are {cards}"
        size = 2 * int(cards["NAXIS1"]) * int(cards["NAXIS2"])
        data = file.read(size)
    if len(data) < size:
        return f"none: it has {len(data)} bytes of pixels, wanted {size}"
    # subtracting 32,768 turns the highest bit over
    swapped = bytearray(size)
    swapped[0::2] = data[1::2]
    swapped[1::2] = bytes(byte ^ 0x80 for byte in data[0::2])
    return hashlib.sha256(swapped).hexdigest()


def is_one(one_s: float, other_s: float) -> bool:
    return abs(one_s - other_s) < SAME_START_S


def utc_s(text: str) -> float:
    return datetime.datetime.fromisoformat(text).timestamp()
