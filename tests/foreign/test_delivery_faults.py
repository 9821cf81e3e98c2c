"""Deliveries that are killed at random points, some 200 times, and destinations and databases that fail in the middle.

Each exposure ends as exactly one valid file at the destination; nothing is overwritten, and nothing leaves the archive that is nowhere else.
"""

import contextlib
import datetime
import pathlib
import random
import re
import shutil
import sqlite3
import subprocess
import tempfile
import time

import pytest
from deliveries import (Site, add_copies, add_store, answers, are_whole_copies, files, frames_below, is_whole, manifests_below, night, opened, process,  # noqa: F401 (fixtures)
                        store, tmpfs, until)
from ports import free_port

# some 200 kills, most of them where they cost least
KILLS_INTO_FOLDER, KILLS_INTO_STORE, KILLS_OF_COPIES, KILLS_OF_NODES = 120, 10, 40, 30


@pytest.fixture
def site(starmesh, night):
    """In memory: a try that begins again reads everything from the disk, which is not what is tried here."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        yield Site(starmesh, night, pathlib.Path(folder))


def killed_again_and_again(site: Site, name: str, arrived, kills: int):
    """Kills deliveries, each when more files have arrived than at the last kill; at least half of them must have been under way."""
    rest = random.Random(20261125)
    under_way = 0
    for number in range(kills):
        wanted = number * len(site.frames) // kills
        child = subprocess.Popen([site.starmesh, "night", "deliver", "last", "--to", name], cwd=site.folder,
                                 stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until(lambda: child.poll() is not None or arrived() >= wanted, every_s=0.001)
        time.sleep(rest.uniform(0.0, 0.02))
        under_way += child.poll() is None
        child.kill()
        child.wait()
    assert under_way >= kills // 2, under_way
    done = site.deliver(name)
    assert done.returncode == 0, done.stdout


def test_deliveries_to_a_folder_that_are_killed_deliver_each_frame_once(site, tmp_path):
    with tmpfs(tmp_path / "share", "size=200m") as share:
        site.add(f'[[delivery]]\nname = "share"\ndirectory = "{share}"\n')
        killed_again_and_again(site, "share", lambda: frames_below(share), KILLS_INTO_FOLDER)
        is_whole(site, {name: content for name, content in files(share).items() if ".starmesh-part" not in name})


def test_deliveries_to_a_store_that_are_killed_deliver_each_frame_once(site, store):
    add_store(site, store)
    store.mode = "slow"
    killed_again_and_again(site, "store", store.count, KILLS_INTO_STORE)
    is_whole(site, store.objects())


def test_deliveries_of_copies_that_are_killed_deliver_each_frame_once(site):
    add_copies(site, site.folder / "there")
    killed_again_and_again(site, "lco", lambda: frames_below(site.folder / "there"), KILLS_OF_COPIES)
    are_whole_copies(site, site.folder / "there")


def ask(site: Site, sql: str):
    """Asks the database, or changes it, and lets go of it."""
    with opened(site.folder / "data/archive.db") as database:
        return database.execute(sql).fetchone()


@contextlib.contextmanager
def day_after(site: Site, days: int = 0):
    """The clock of a simulator, on the day after the night or later; gives the words that start the archive node."""
    (last,) = ask(site, "SELECT max(date_obs) FROM images")
    port = free_port()
    text = (site.folder / "observatory.toml").read_text()
    (site.folder / "observatory.toml").write_text(re.sub(r"http://127.0.0.1:\d+", f"http://127.0.0.1:{port}", text, count=1))
    start = f"{datetime.date.fromisoformat(last[:10]) + datetime.timedelta(days)}T23:00:00Z"
    with process(site.starmesh, "simulator", "--bind", f"127.0.0.1:{port}", "--start", start, cwd=site.folder):
        until(lambda: answers(port))
        yield [site.starmesh, "node", "archive", "--config", "observatory.toml"]


def test_the_archive_node_completes_headers_and_delivers_copies_whatever_kills_it(site):
    """The node is killed at random points, mostly while it completes headers or delivers."""
    there, rest = site.folder / "there", random.Random(1125)
    site.own_images()
    add_copies(site, there)

    def progress() -> int:
        return int(ask(site, "SELECT total(complete_hdr) FROM images")[0]) + frames_below(there)

    hit, kills = set(), 0
    with day_after(site) as node:
        # on a busy machine each life gets further, and it takes fewer of them
        while kills < KILLS_OF_NODES and (before := progress()) < 2 * len(site.frames):
            kills += 1
            with process(*node, cwd=site.folder):
                end = time.monotonic() + 20
                until(lambda: progress() > before or time.monotonic() > end, every_s=0.002)
                time.sleep(rest.uniform(0.0, 0.06))
            hit.add(progress())
        with process(*node, cwd=site.folder):
            until(lambda: manifests_below(there), 90)
    # what the last kill left goes with the next try
    assert site.deliver("lco").returncode == 0
    assert kills >= 6 and len(hit) > kills // 3, f"most of {kills} kills hit nothing: {sorted(hit)}"
    are_whole_copies(site, there)


def alerts_of(site: Site, since: int = 0) -> str:
    """What the node's log says of alerts, from a byte on."""
    return (site.folder / "node.log").read_bytes()[since:].decode()


@contextlib.contextmanager
def archive_node(site: Site, node: list[str]):
    with open(site.folder / "node.log", "ab") as log, process(*node, cwd=site.folder, stdout=log, stderr=log) as child:
        yield child


def test_a_destination_that_is_full_and_a_database_that_is_locked_are_alerts_and_go_on_when_mended(site, tmp_path):
    site.own_images()
    ask(site, "UPDATE images SET complete_hdr = 1")
    with tmpfs(tmp_path / "share", "size=1m") as share, day_after(site) as node:
        add_copies(site, share)
        with archive_node(site, node):
            until(lambda: "was not delivered to lco" in alerts_of(site) and "No space left" in alerts_of(site), 90)
            before = {name: content for name, content in files(share).items() if ".starmesh-part" not in name}
            assert not any(name.endswith(".json") for name in before)
        with contextlib.closing(sqlite3.connect(site.folder / "data/archive.db")) as locked:
            locked.execute("PRAGMA locking_mode = EXCLUSIVE")
            locked.execute("BEGIN EXCLUSIVE")
            locked.execute("UPDATE images SET bytes = bytes")
            subprocess.run(["mount", "-o", "remount,size=200m", str(share)], check=True)
            done = site.deliver("lco")
            assert done.returncode != 0 and "database is locked" in done.stdout + done.stderr, done.stdout + done.stderr
            mark = (site.folder / "node.log").stat().st_size
            with archive_node(site, node):
                until(lambda: "database is locked" in alerts_of(site, mark), 90)
            locked.rollback()
        with archive_node(site, node):
            until(lambda: manifests_below(share), 90)
        assert site.deliver("lco").returncode == 0
        after = files(share)
        assert all(after[name] == content for name, content in before.items()), "what was there was changed"
        are_whole_copies(site, share)


def test_a_corrupt_page_of_the_database_stops_a_delivery_with_a_clear_reason(site):
    add_copies(site, site.folder / "there")
    database, whole = site.folder / "data/archive.db", site.folder / "whole.db"
    ask(site, "PRAGMA wal_checkpoint(TRUNCATE)")
    (page,) = ask(site, "SELECT rootpage FROM sqlite_schema WHERE name = 'images'")
    (size,) = ask(site, "PRAGMA page_size")
    shutil.copy(database, whole)
    content = bytearray(database.read_bytes())
    content[(page - 1) * size:page * size] = b"\x7f" * size
    database.write_bytes(content)
    for command in ["deliver", "verify"]:
        done = site.run("night", command, "last", "--to", "lco")
        assert done.returncode != 0 and "malformed" in done.stdout + done.stderr, done.stdout + done.stderr
    assert not list((site.folder / "there").rglob("*.*"))
    shutil.copy(whole, database)
    assert site.deliver("lco").returncode == 0
    are_whole_copies(site, site.folder / "there")


def test_nothing_leaves_the_archive_for_a_destination_that_leads_back_to_it(site, tmp_path):
    """The folder of the destination is on another disk, and the telescope's folder in it is the folder of images."""
    site.own_images()
    ask(site, "UPDATE images SET complete_hdr = 1")
    with tmpfs(tmp_path / "share", "size=200m") as share, day_after(site, days=3) as node:
        config = (site.folder / "observatory.toml").read_text()
        site.add(f'[[delivery]]\nname = "share"\ndirectory = "{share}"\n')
        site.add("[archive]\nremove_delivered_after_days = 1\n")
        telescope = share / re.search(r'^site *= *"(.*?)"', config, re.M)[1] / re.search(r'^telescope *= *"(.*?)"', config, re.M)[1]
        telescope.mkdir(parents=True)
        subprocess.run(["mount", "--bind", str(site.images), str(telescope)], check=True)
        try:
            with archive_node(site, node):
                until(lambda: manifests_below(site.images), 90)
            with archive_node(site, node):
                until(lambda: "leads back to the folder of images" in alerts_of(site), 90)
            assert {str(path.relative_to(site.images)) for path in site.images.rglob("*.fits")} == set(site.frames)
            assert not list(site.images.rglob("*.leaving"))
        finally:
            subprocess.run(["umount", "-l", str(telescope)], check=True)
