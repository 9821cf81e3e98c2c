"""A harness whose supervisor is `starmesh up` itself."""

import contextlib
import os
import pathlib
import signal

from harness import ROLE, Harness, wait


class UpHarness(Harness):
    """The nodes are children of `up`; device nodes outlive it."""

    def start_all(self):
        self.spawn("up", [self.binary, "up", str(self.configuration)])

    def pids(self, words: str = " node ") -> list[int]:
        """Processes of this harness's nodes: what was started with its configuration."""
        found = []
        for entry in pathlib.Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            with contextlib.suppress(OSError):
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if str(self.folder) in line and words in line and str(self.binary) in line:
                    found.append(int(entry.name))
        return found

    def signal(self, number: signal.Signals, *nodes: str):
        for node in nodes:
            role = ROLE.get(node)
            for pid in self.pids(f" node {role} --id {node} " if role else f" node {node} "):
                os.kill(pid, number)
            (self.stopped.add if number == signal.SIGSTOP else self.stopped.discard)(node)

    def kill_nodes(self, *words: str):
        for word in words:
            for pid in wait(f"{word} runs", lambda word=word: self.pids(word), 20):
                os.kill(pid, signal.SIGKILL)
        self.mark()

    def kill_up(self):
        self.processes["up"].kill()
        self.mark()
        self.processes["up"].wait()

    def heal(self):
        self.wire.heal()
        for relay in self.relays.values():
            relay.honest()
        self.signal(signal.SIGCONT, *list(self.stopped))
        if self.processes["up"].poll() is not None:
            self.end_nodes()
            self.start_all()

    def end_nodes(self):
        for pid in self.pids():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def stop(self):
        self.end("up")
        self.end_nodes()
        super().stop()
