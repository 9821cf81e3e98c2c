#!/usr/bin/env python3
"""Runs `cargo test ...`; what fails is tried once more, one by one, on a machine that has nothing else to do.

    scripts/again.py cargo test --workspace ... [-- ...]

Stories of real nodes wait for real clocks, and a test machine of two busy cores is late now and then. What fails twice has
failed; what passes alone is told at the end, so that it is seen when a test does so again and again.
"""

import re
import subprocess
import sys

FAILED = re.compile(r"^    (\S+)$")
TARGET = re.compile(r"^error: test failed, to rerun pass `(.*)`")


def run(command: list[str]) -> tuple[int, list[str]]:
    """Shows what it says while it says it; returns how it ended, and its lines."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    lines = []
    for line in process.stdout:
        sys.stdout.write(line)
        sys.stdout.flush()
        lines.append(line.rstrip("\n"))
    return process.wait(), lines


def failures(lines: list[str]) -> list[tuple[list[str], list[str]]]:
    """Of each target that failed: how to choose it, and the names of its tests; none where it did not come so far."""
    found, names, listing = [], [], False
    for line in lines:
        if line == "failures:":
            names, listing = [], True
        elif listing and (match := FAILED.match(line)):
            names.append(match[1])
        elif match := TARGET.match(line):
            # without the package: other packages' features would build it anew
            words = match[1].split()
            if "-p" in words:
                at = words.index("-p")
                del words[at:at + 2]
            found.append((words, names))
            names, listing = [], False
    return found


def main() -> int:
    command = sys.argv[1:]
    code, lines = run(command)
    if code == 0:
        return 0
    failed = failures(lines)
    if not failed or not all(names for _, names in failed):
        return code
    base = command[:command.index("--")] if "--" in command else command
    # the target is chosen anew
    chosen = [word for at, word in enumerate(base) if word != "--test" and (at == 0 or base[at - 1] != "--test")]
    late = []
    for target, names in failed:
        for name in names:
            print(f"\n--- once more, alone: {name}", flush=True)
            code, lines = run([*chosen, *target, "--", "--exact", name, "--test-threads", "1"])
            passed = any(re.match(r"test result: ok\. 1 passed", line) for line in lines)
            if code != 0 or not passed:
                print(f"--- failed twice: {name}")
                return 1
            late.append(name)
    print("\n--- failed among others, and passed alone:", *late, sep="\n    ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
