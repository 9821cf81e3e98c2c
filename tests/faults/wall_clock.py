"""The wall clock of a process, which jumps when told to (libfaketime); its monotonic clocks stay exact."""

import os
import pathlib

USUAL = pathlib.Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1")


class WallClock:
    """`environment` goes to the processes that follow this clock; `file` says how far it is off."""

    def __init__(self, file: pathlib.Path):
        found = [USUAL] if USUAL.exists() else sorted(pathlib.Path("/usr/lib").rglob("libfaketimeMT.so.1"))
        if not found:
            raise FileNotFoundError("libfaketime is missing: apt-get install faketime (scripts/setup test does)")
        self.file = file
        self.environment = {"LD_PRELOAD": str(found[0]), "FAKETIME_TIMESTAMP_FILE": str(file),
                            "FAKETIME_DONT_FAKE_MONOTONIC": "1", "FAKETIME_CACHE_DURATION": "1"}
        self.jump(0)

    def jump(self, seconds: int):
        """Takes effect within a second."""
        part = self.file.with_suffix(".part")
        part.write_text(f"{seconds:+d}\n")
        os.replace(part, self.file)
