"""What a machine runs out of: room on a disk, a disk that can be written, files for a process."""

import contextlib
import pathlib
import resource
import shutil
import subprocess

FULL = 1 << 16  # bytes free, at most


@contextlib.contextmanager
def room(folder: pathlib.Path):
    """No room on the disk of this folder."""
    ballast = folder / "ballast"
    try:
        with open(ballast, "wb", buffering=0) as file:
            for size in (1 << 20, 1 << 12):
                with contextlib.suppress(OSError):
                    while True:
                        file.write(b"\0" * size)
        if shutil.disk_usage(folder).free > FULL:
            raise RuntimeError("the disk is not full")
        yield
    finally:
        ballast.unlink(missing_ok=True)


@contextlib.contextmanager
def writing(folder: pathlib.Path):
    """The folder is read-only."""
    subprocess.run(["mount", "--bind", folder, folder], check=True)
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", folder], check=True)
        with contextlib.suppress(OSError):
            (folder / "probe").write_text("x")
            raise RuntimeError(f"{folder} is not read-only")
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@contextlib.contextmanager
def files(pid: int):
    """No more files for this process than it has open now."""
    had = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    if sum(int(fd.name) > 2 for fd in pathlib.Path(f"/proc/{pid}/fd").iterdir()) == 0:
        raise RuntimeError("the process has no files open")
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, had[1]))
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(pid, resource.RLIMIT_NOFILE, had)
