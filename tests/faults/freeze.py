"""Stops some threads of a process, as a deadlock would: by ptrace, since a signal stops all of them."""

import ctypes
import os
import pathlib
import queue
import threading

from wire import Late

SEIZE, INTERRUPT, DETACH = 0x4206, 0x4207, 17
WALL = 0x40000000
LIBC = ctypes.CDLL(None, use_errno=True)


def trace(request: int, thread: int):
    if LIBC.ptrace(ctypes.c_long(request), ctypes.c_long(thread), None, None) < 0:
        raise OSError(ctypes.get_errno(), f"ptrace {request:#x} of thread {thread}")


class Frozen:
    """The threads of `pid` whose names begin with one of `names`, until `thaw`; the tracer must stay one thread."""

    def __init__(self, pid: int, *names: str):
        self.pid, self.names = pid, names
        self.end, self.outcomes = threading.Event(), queue.SimpleQueue()
        self.thread = threading.Thread(target=self.hold, daemon=True)
        self.thread.start()
        outcome = self.outcomes.get(timeout=10)
        if isinstance(outcome, Exception):
            raise outcome
        self.count = outcome

    def threads(self) -> list[int]:
        tasks = pathlib.Path(f"/proc/{self.pid}/task").iterdir()
        return [int(task.name) for task in tasks if (task / "comm").read_text().startswith(self.names)]

    def hold(self):
        held = []
        try:
            for thread in self.threads():
                trace(SEIZE, thread)
                trace(INTERRUPT, thread)
                os.waitpid(thread, WALL)
                held.append(thread)
            if not held:
                raise Late(f"process {self.pid} has no threads called {self.names}")
            self.outcomes.put(len(held))
            self.end.wait(120)
        except Exception as error:
            self.outcomes.put(error)
        for thread in held:
            try:
                trace(DETACH, thread)
            except OSError:
                pass  # the process has ended meanwhile

    def thaw(self):
        self.end.set()
        self.thread.join(10)
