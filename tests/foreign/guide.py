"""Types docs/operator/first-night.md into three terminals, in a network namespace of its own: `guide.py STARMESH DOCUMENT HOME PAUSE_S`,
with a pause before each block, as somebody makes who reads it first.

The document is the script. A block `sh` begins with the terminal that its lines are typed into; a block `text` after it is what that
terminal must show since, line by line, where `...` stands for anything and any width of white space for white space. A line with the
comment "again until" is typed again until the terminal shows it. `# press Ctrl-C` is the interrupt. Standard library only; what was shown
is printed at the end, or which line was not.
"""

import os
import pathlib
import re
import signal
import subprocess
import sys
import threading
import time

# how long a reader waits for what a command shows, s; only what never comes takes so long
LIMIT_S = 900
# and how long before they type it again, s
AGAIN_S = 2.0
CTRL_C = "# press Ctrl-C"


class Terminal:
    """A shell, and everything that it has shown."""

    def __init__(self, home: pathlib.Path):
        self.shell = subprocess.Popen(["bash"], cwd=home, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                      text=True, errors="replace", bufsize=1, start_new_session=True)
        self.shown: list[str] = []
        self.begin = 0
        self.reader = threading.Thread(target=lambda: self.shown.extend(iter(self.shell.stdout.readline, "")), daemon=True)
        self.reader.start()

    def type(self, line: str):
        self.shell.stdin.write(line + "\n")
        self.shell.stdin.flush()

    def press_ctrl_c(self):
        """The kernel sends it to all that runs in a terminal; the shell itself only waits on."""
        for process in processes_of(self.shell.pid):
            os.kill(process, signal.SIGINT)

    def text(self) -> str:
        return "".join(self.shown[self.begin:])


def processes_of(session: int) -> list[int]:
    """The processes of a session except its leader."""
    found = []
    for entry in pathlib.Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and int(entry.name) != session and os.getsid(int(entry.name)) == session:
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def blocks(document: str) -> list[tuple[str, list[str]]]:
    """The blocks `sh` and `text` of a document, in order."""
    found = re.findall(r"^ *```(sh|text)\n(.*?)^ *```$", document, flags=re.M | re.S)
    return [(kind, text.splitlines()) for kind, text in found]


def pattern(line: str) -> re.Pattern:
    """What a printed line stands for."""
    expression, anything, first = r"^", False, True
    for word in line.split():
        if word == "...":
            anything = True
            continue
        if first:
            expression += r"(?:.*?\s)?" if anything else r"\s*"
        else:
            expression += r"\s+(?:.*?\s+)?" if anything else r"\s+"
        expression += ".*?".join(map(re.escape, word.split("...")))
        anything = first = False
    return re.compile(expression + (r"(?:\s.*)?$" if anything else r"\s*$"))


def missing(expected: list[str], text: str) -> str | None:
    """The first line that is not among those of a text, in order."""
    lines = iter(text.splitlines())
    for line in expected:
        # lines in between need not be named
        if line.strip() == "...":
            continue
        wanted = pattern(line)
        if not any(wanted.search(shown) for shown in lines):
            return line
    return None


def is_shown(terminal: Terminal, expected: list[str], seconds: float) -> str | None:
    """Waits until the terminal shows the lines; the first that it does not."""
    until = time.monotonic() + seconds
    while (lacks := missing(expected, terminal.text())) is not None and time.monotonic() < until:
        time.sleep(0.1)
    return lacks


def follow(document: str, home: pathlib.Path, terminals: dict[str, Terminal], pause_s: float):
    steps = blocks(document)
    for index, (kind, lines) in enumerate(steps):
        if kind != "sh":
            continue
        if terminals:
            time.sleep(pause_s)
        head = re.fullmatch(r"# (terminal \d)", lines[0])
        if not head:
            raise SystemExit(f"a block begins with {lines[0]!r}, not with its terminal")
        if head[1] not in terminals:
            terminals[head[1]] = Terminal(home)
        terminal = terminals[head[1]]
        following = steps[index + 1] if index + 1 < len(steps) else ("", [])
        expected = following[1] if following[0] == "text" else []
        terminal.begin = len(terminal.shown)
        for line in lines[1:]:
            if line == CTRL_C:
                terminal.press_ctrl_c()
                continue
            until = time.monotonic() + LIMIT_S
            if "# again until" not in line:
                terminal.type(line)
                continue
            while True:
                terminal.begin = len(terminal.shown)
                terminal.type(line)
                if is_shown(terminal, expected, AGAIN_S) is None or time.monotonic() > until:
                    break
        lacks = is_shown(terminal, expected, LIMIT_S)
        if lacks is not None:
            raise SystemExit(f"after {lines[1:]} {head[1]} does not show the line\n  {lacks}\nbut\n{terminal.text()}")


def main(starmesh: str, document: str, home: str, pause_s: str):
    for words in ["link set lo up", "link set lo multicast on", "route add 224.0.0.0/4 dev lo"]:
        subprocess.run(["ip", *words.split()], check=True)
    os.environ["HOME"], os.environ["PATH"] = home, f"{pathlib.Path(starmesh).parent}:{os.environ['PATH']}"
    terminals: dict[str, Terminal] = {}
    try:
        follow(pathlib.Path(document).read_text(), pathlib.Path(home), terminals, float(pause_s))
        for name, terminal in terminals.items():
            until = time.monotonic() + 30
            while (left := processes_of(terminal.shell.pid)) and time.monotonic() < until:
                time.sleep(0.2)
            if left:
                raise SystemExit(f"{name}: processes {left} still run at the end of the guide")
    finally:
        for name, terminal in terminals.items():
            print(f"=== {name}\n" + "".join(terminal.shown))
        # what a failed guide left, the nodes before the simulator, which still answers them
        for terminal in sorted(terminals.values(), key=lambda each: -each.shell.pid):
            terminal.press_ctrl_c()
            until = time.monotonic() + 40
            while processes_of(terminal.shell.pid) and time.monotonic() < until:
                time.sleep(0.2)
            for process in processes_of(terminal.shell.pid):
                os.kill(process, signal.SIGKILL)
            terminal.shell.stdin.close()
            terminal.shell.wait(timeout=10)


if __name__ == "__main__":
    main(*sys.argv[1:])
