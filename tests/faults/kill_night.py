"""A telescope whose nodes are killed at random instants of a busy night: its rows are short and its sky runs four times
as fast. A night is rounds; each takes two schedules, and ends when all rows that the second one has are done."""

import contextlib
import datetime
import json
import os
import pathlib
import random
import time

from kill_count import EXPOSURE_S, READOUT_S, SPEED, WANTED, Count, spooled
from harness import SHUTTER_S, TELESCOPE, Late, Harness, Wire, arrived_s, wait

DARK_S = 0.2
# who dies, and how often of eleven times; the last is all three in one instant, as in a power cut
VICTIMS = [("observatory",)] * 5 + [("hands",)] * 3 + [("archive",)] * 2 + [("hands", "observatory", "archive")]
# the row that only the first schedule has never has enough
ENDLESS = "endless"
# a new schedule is in force, and what it takes from the telescope has ended, within this time, machine s
TAKEN_S = 1.5
# a killed observatory commands again after 5 s; a frame that has not begun then is not waited for, machine s
FRAME_WITHIN_S = 8.0


class Night(Harness):
    """Rounds of two schedules with kills among them."""

    def __init__(self, binary: str, name: str, chance: random.Random):
        self.chance, self.round, self.frames = chance, 0, 0
        # (who, when, while what); and for each death of the camera's node, the starts of the frames that its disk had
        self.kills: list[tuple] = []
        self.deaths: list[tuple[float, list[float]]] = []
        self.put_at = 0.0
        super().__init__(binary, name, exposure_s=EXPOSURE_S)

    def start_simulator(self):
        host = self.host("simulator")
        self.wire = Wire(host, self.alpaca_port)
        self.spawn("simulator", [self.binary, "simulator", "--bind", f"{host}:{self.alpaca_port}", "--size-px", "64",
                                 "--shutter-s", str(SHUTTER_S), "--slew-deg-per-s", "90", "--speed", str(SPEED),
                                 "--start", "2026-11-21T03:00:00Z"])

        def answers():
            with contextlib.suppress(OSError):
                return self.wire.world()
            return None
        wait("the simulator answers", answers, 60)

    def write_config(self):
        super().write_config()
        with open(self.configuration, "a") as file:
            # a killed device node is back within a second
            file.write("[faults]\npause_s = 0.5\nrest_s = 1.0\nretries = 20\n")

    def start_all(self):
        for node in ("dome", "hands", "observatory", "archive"):
            self.start(node)

    # -- the schedules

    def write_schedule(self):
        """Nothing yet: each round brings its own."""
        self.put([])

    def put(self, rows: list[dict]):
        """A schedule, put in the file's place in one step; a last row keeps the night from ending."""
        part = self.folder / "schedule.jsonl.part"
        part.write_text("".join(json.dumps(row) + "\n" for row in [*rows, self.row("close", {}, 5.0)]))
        os.replace(part, self.folder / "schedule.jsonl")
        self.put_at = time.time()

    def row(self, action: str, value: dict, from_h: float = -3.0, until_h: float = 6.0) -> dict:
        times = {"start_time": from_h, "end_time": until_h}
        begin = datetime.datetime(2026, 11, 21, 3, tzinfo=datetime.timezone.utc)
        return {"device_name": "camera", "action_type": action, "action_value": value,
                **{name: (begin + datetime.timedelta(hours=h)).isoformat() for name, h in times.items()}}

    def light(self, word: str, n: int, az: float) -> dict:
        return self.row("object", {"object": f"{word} {self.round}", "alt": 60.0, "az": az, "exptime": EXPOSURE_S,
                                   "n": n, "filter": "V", "metadata": self.metadata(word)})

    def metadata(self, word: str) -> dict:
        """By this the frames of a row are known in the database."""
        return {"visit": str(self.round), "word": word}

    def first_rows(self) -> list[dict]:
        """In random order: two targets far apart, darks, and a closing at whose end the dome opens anew; among them, not
        at their head, a row without an end."""
        dark = {"exptime": [DARK_S], "n": [WANTED["dark"]], "metadata": self.metadata("dark")}
        rows = [self.light("first", WANTED["first"], 90.0), self.light("second", WANTED["second"], 250.0),
                self.row("calibration", dark), self.row("close", {}, until_h=6.0 + self.round / 3600.0)]
        self.chance.shuffle(rows)
        rows.insert(self.chance.randint(1, len(rows)), self.light(ENDLESS, 10_000, 120.0))
        return rows

    def second_rows(self, rows: list[dict]) -> list[dict]:
        """The same in another order, with another target in the place of the row without an end."""
        stay = [row for row in rows if row["action_value"].get("n") != 10_000]
        self.chance.shuffle(stay)
        return [*stay, self.light("late", WANTED["late"], 180.0)]

    # -- one round

    def play(self, kills: int, limit_s: float) -> list[str]:
        """So many kills while two schedules are worked through, and the count at their end; returns what is wrong."""
        self.round += 1
        count = Count(self, self.wire.last())
        ended_before = len(count.ended())
        rows = self.first_rows()
        self.put(rows)
        among_second = min(kills, self.chance.randint(1, 3))
        for _ in range(kills - among_second):
            self.await_the_instant()
            self.kill_one(count)
        rows = self.second_rows(rows)
        self.put(rows)
        time.sleep(self.chance.uniform(0.0, TAKEN_S))
        for left in range(among_second, 0, -1):
            self.kill_one(count)
            if left > 1:
                self.await_the_instant()
        wait(f"round {self.round}: all rows end", lambda: len(count.ended()) >= ended_before + len(rows), limit_s, 0.2)
        try:
            wait("the count", lambda: not count.faults(), 60.0, 0.3)
        except Late:
            return count.faults()
        # one frame more would come now
        time.sleep(1.5)
        wrong = count.faults()
        self.frames += 0 if wrong else count.frames
        return wrong

    def await_the_instant(self):
        """Mostly somewhere between a frame's start and its file, else anywhere: while a node that was killed last starts,
        the dome opens or closes, the mount slews."""
        if self.chance.random() < 0.6:
            since = self.wire.last()
            with contextlib.suppress(Late):
                wait("a frame begins", lambda: self.puts("startexposure", since), FRAME_WITHIN_S, 0.05)
            time.sleep(self.chance.uniform(0.0, (EXPOSURE_S + READOUT_S) / SPEED + 0.4))
        else:
            time.sleep(self.chance.uniform(0.05, 4.0))

    def kill_one(self, count: Count):
        nodes = self.chance.choice(VICTIMS)
        phase = self.phase_now(count.first_put)
        self.kill(*nodes)
        if "hands" in nodes:
            self.deaths.append((self.t0, spooled(self.spool())))
        self.kills.append(("all three" if len(nodes) > 1 else nodes[0], self.t0, phase))
        if self.chance.random() < 0.3:
            time.sleep(self.chance.uniform(0.0, 1.0))
        for node in nodes:
            self.start(node)

    def phase_now(self, first_put: int) -> str:
        """What the newest command that arrived at a device has begun, if that still goes on; for the table only."""
        now = time.time()
        last = max((at for node, at, _ in self.kills if node != "archive"), default=0.0)
        lasting = {"startexposure": EXPOSURE_S, "openshutter": SHUTTER_S, "closeshutter": SHUTTER_S, "park": 2.0,
                   "slewtocoordinatesasync": 2.0}
        begun = [put for put in self.wire.puts(first_put) if put["member"] in lasting]
        newest = begun[-1] if begun else {"member": "", "wall_utc": "1970-01-01T00:00:00Z"}
        into_s = (now - arrived_s(newest)) * SPEED
        if now - self.put_at < TAKEN_S:
            return "a schedule is taken"
        if newest["member"] == "startexposure":
            for until_s, phase in ((EXPOSURE_S, "exposing"), (EXPOSURE_S + READOUT_S, "reading out"),
                                   (EXPOSURE_S + READOUT_S + 0.5 * SPEED, "storing")):
                if into_s < until_s:
                    return phase
        if into_s < lasting.get(newest["member"], 0.0):
            return {"openshutter": "opening", "closeshutter": "closing", "park": "closing"}.get(newest["member"], "slewing")
        return "a node starts" if now - last < 6.0 else "between"

    def spool(self) -> pathlib.Path:
        return self.data / f"spool-{TELESCOPE}-hands"
