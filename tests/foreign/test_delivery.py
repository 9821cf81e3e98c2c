"""A night of the demo is handed over by typing what docs/operator/delivery.md says, to real destinations and to broken ones.

Destinations: a folder on a file system of its own, rsync over a real sshd, an rsync daemon, and the S3 server of PyPI moto.
"""

import contextlib
import hashlib
import json
import os
import pathlib
import re
import sqlite3
import subprocess

import duckdb
from astropy.io import fits
from deliveries import (SECRET, Site, add_copies, add_store, block, files, frames_below, is_whole, manifests_below, night,  # noqa: F401 (fixtures)
                        process, site, store, tmpfs, until)
from ports import free_port
from shared import PROJECT


def test_a_night_goes_into_a_folder_as_the_document_says(site, tmp_path):
    with tmpfs(tmp_path / "share", "size=200m") as share:
        site.add(block("toml", "directory").replace("/mnt/share", str(share)))
        site.type(block("sh", "--to share"))
        is_whole(site, files(share))
        # by the line of the document, without Starmesh
        check = block("sh", "sha256sum --check")
        name = next(share.rglob("*.manifest.json")).relative_to(share)
        check = check.replace("paranal/callisto/20261121.manifest.json", str(name))
        done = subprocess.run(check, shell=True, cwd=share, capture_output=True, text=True)
        assert done.returncode == 0 and done.stdout.count(": OK") == len(site.frames), done.stderr
        first = next(share.rglob("*.fits"))
        with fits.open(first) as frame:
            frame.verify("exception")
        # changed after the delivery
        content = bytearray(first.read_bytes())
        content[-2000] ^= 1
        first.write_bytes(content)
        done = site.run("night", "verify", "last", "--to", "share")
        assert done.returncode != 0 and first.name in done.stdout and "changed there" in done.stdout, done.stdout
        done = site.deliver("share")
        assert done.returncode != 0 and "not overwritten" in done.stdout, done.stdout
        assert first.read_bytes() == content


def test_a_share_that_is_full_or_read_only_is_reported_and_then_goes_on(site, tmp_path):
    with tmpfs(tmp_path / "share", "size=1m") as share:
        site.add(block("toml", "directory").replace("/mnt/share", str(share)))
        done = site.deliver("share")
        assert done.returncode != 0 and "No space left" in done.stdout and "free its disk" in done.stdout, done.stdout
        arrived = {name for name in files(share)}
        assert all(name.endswith(".fits") for name in arrived), arrived
        subprocess.run(["mount", "-o", "remount,ro", str(share)], check=True)
        done = site.deliver("share")
        assert done.returncode != 0 and "Read-only" in done.stdout, done.stdout
        assert set(files(share)) == arrived
        subprocess.run(["mount", "-o", "remount,rw,size=200m", str(share)], check=True)
        done = site.deliver("share")
        assert done.returncode == 0 and f"{len(arrived)} were there" in done.stdout, done.stdout
        is_whole(site, files(share))
    # not mounted any more
    done = site.deliver("share")
    assert done.returncode != 0 and "is not mounted" in done.stdout, done.stdout
    assert not any((tmp_path / "share").iterdir())


def test_a_night_goes_into_an_object_store_as_the_document_says(site, store):
    add_store(site, store)
    site.type(block("sh", "--to store"))
    is_whole(site, store.objects())
    done = site.deliver("store")
    assert done.returncode == 0 and "0 sent" in done.stdout
    name = next(name for name in store.objects() if name.endswith(".fits"))
    store.client().put_object(Bucket="nights", Key=name, Body=b"something else")
    done = site.run("night", "verify", "last", "--to", "store")
    assert done.returncode != 0 and name in done.stdout, done.stdout
    (site.folder / "store.secret").unlink()
    done = site.deliver("store")
    assert done.returncode != 0 and "secret file" in done.stdout, done.stdout


def test_a_store_that_lies_is_noticed_and_its_files_are_sent_again(site, store):
    add_store(site, store)
    for mode, words in [("lies", "gives back other bytes"), ("forgets", "does not have it")]:
        store.mode = mode
        done = site.deliver("store")
        assert done.returncode != 0 and words in done.stdout, done.stdout
        assert store.objects() == {} and SECRET not in done.stdout + done.stderr
    store.mode = "honest"
    done = site.deliver("store")
    assert done.returncode == 0, done.stdout
    is_whole(site, store.objects())


def test_a_store_that_cannot_be_reached_or_refuses_is_reported(site):
    site.add(block("toml", "bucket").replace("https://s3.example.org", f"http://127.0.0.1:{free_port()}"))
    (site.folder / "store.secret").write_text(SECRET)
    done = site.deliver("store")
    assert done.returncode != 0 and "cannot be reached" in done.stdout, done.stdout
    assert SECRET not in done.stdout + done.stderr


def without_programme(site: Site, count: int) -> list[str]:
    """Some frames of the sky whose rows named no programme; the others are of the demo's own one."""
    with sqlite3.connect(site.folder / "data/archive.db") as database:
        database.execute("UPDATE images SET complete_hdr = 1")
        rows = database.execute("SELECT frame_id, file, frame FROM images WHERE file LIKE '%light%' LIMIT ?", [count]).fetchall()
        for frame_id, file, frame in rows:
            frame = json.loads(frame)
            assert frame["purpose"].pop("programme") == "DEMO.2026"
            database.execute("UPDATE images SET frame = ? WHERE frame_id = ?", [json.dumps(frame), frame_id])
            with fits.open(site.images / file, do_not_scale_image_data=True) as image:
                del image[0].header["PROGID"]
                image.writeto(site.folder / "changed.fits", checksum=True)
            (site.folder / "changed.fits").rename(site.images / file)
    return [file for _, file, _ in rows]


def test_copies_that_a_profile_refuses_are_named_with_the_rule(site, tmp_path):
    there, toml = tmp_path / "there", site.folder / "observatory.toml"
    site.own_images()
    refused = without_programme(site, 3)
    add_copies(site, there)
    with_proposal = toml.read_text()
    toml.write_text(with_proposal.replace('PROPID = "2026A-001", ', ""))
    done = site.deliver("lco")
    assert done.returncode != 0 and "PROPID is missing" in done.stdout and "required by ocs-archive" in done.stdout, done.stdout
    assert all(file in done.stdout for file in refused), done.stdout
    # the others are there, and the manifest waits
    assert frames_below(there) == len(site.frames) - 3 and not manifests_below(there)
    # what everybody would see at once
    toml.write_text(with_proposal.replace("2026A-001", "calibrate"))
    checked = site.run("check", "observatory.toml")
    assert "public at once: PROPID is 'calibrate'" in checked.stdout + checked.stderr, checked.stdout
    toml.write_text(with_proposal)
    done = site.deliver("lco")
    assert done.returncode == 0 and "3 sent" in done.stdout, done.stdout
    proposals = [fits.getheader(path)["PROPID"] for path in there.rglob("*.fits")]
    assert sorted(set(proposals)) == ["2026A-001", "DEMO.2026"] and proposals.count("2026A-001") == 3
    assert site.run("night", "verify", "last", "--to", "lco").returncode == 0
    # by programme
    site.add(f'[[delivery]]\nname = "ours"\ndirectory = "{there}"\nprofile = "lco"\nprogrammes = [""]\nset = {{ PROPID = "calibrate" }}\n')
    for path in [*there.rglob("*.fits"), *there.rglob("*.json")]:
        path.unlink()
    done = site.deliver("ours")
    assert done.returncode == 0 and "3 frames, 3 sent" in done.stdout and "public at once: PROPID is 'calibrate'" in done.stdout, done.stdout
    checked = site.run("fits", "check", "--profile", "lco", *map(str, there.rglob("*.fits")))
    assert "public at once: PROPID is 'calibrate'" in checked.stdout, checked.stdout
    toml.write_text(with_proposal.replace('SITEID = "lsc"', 'NAXIS1 = "lsc"'))
    done = site.deliver("lco")
    assert done.returncode != 0 and "NAXIS1 cannot be" in done.stderr, done.stderr


@contextlib.contextmanager
def sshd(folder: pathlib.Path):
    """A real sshd of this user; gives the configuration with which ssh reaches it as `data.example.org`."""
    folder.mkdir(mode=0o700)
    for name in ("host", "user"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)], check=True)
    port = free_port()
    pathlib.Path("/run/sshd").mkdir(exist_ok=True)
    (folder / "sshd_config").write_text(
        f"Port {port}\nListenAddress 127.0.0.1\nHostKey {folder}/host\nAuthorizedKeysFile {folder}/user.pub\nStrictModes no\n"
        f"UsePAM no\nPidFile none\nPasswordAuthentication no\nForceCommand {folder}/command\n")
    # what is asked for, and after each copy what a test wants to happen then
    (folder / "command").write_text(f'#!/bin/sh\nsh -c "$SSH_ORIGINAL_COMMAND"; code=$?\ncase "$SSH_ORIGINAL_COMMAND" in\n'
                                    f'rsync*) [ -f {folder}/after ] && sh {folder}/after;;\nesac\nexit $code\n')
    (folder / "command").chmod(0o755)
    key = (folder / "host.pub").read_text().split()
    (folder / "known").write_text(f"[127.0.0.1]:{port} {key[0]} {key[1]}\n")
    config = folder / "ssh_config"
    config.write_text(f"Host data.example.org\n  HostName 127.0.0.1\n  Port {port}\n  IdentityFile {folder}/user\n"
                      f"  IdentitiesOnly yes\n  UserKnownHostsFile {folder}/known\n")
    with process("/usr/sbin/sshd", "-D", "-f", str(folder / "sshd_config")) as server:
        done = until(lambda: subprocess.run(["ssh", "-F", str(config), "-o", "BatchMode=yes", "data.example.org", "true"],
                                            capture_output=True).returncode == 0 or server.poll(), 20)
        assert done is True, "sshd does not start"
        yield config


def test_a_night_goes_by_rsync_over_ssh_and_what_differs_there_is_reported(site, tmp_path):
    there = tmp_path / "nights of all"
    user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
    text = block("toml", "rsync").replace("callisto@data.example.org:/nights", f"{user}@data.example.org:{there}")
    with sshd(tmp_path / "ssh") as config:
        site.add(f'{text}ssh_config = "{config}"\n')
        done = site.deliver("institute")
        assert done.returncode != 0 and "make it there" in done.stdout, done.stdout
        there.mkdir()
        # a folder of a group, which others may not read, stays so
        (there / "demo").mkdir()
        (there / "demo").chmod(0o2770)
        # somebody else makes a file while ours is copied: it stays
        taken = there / "demo/alpha" / sorted(site.frames)[0]
        (config.parent / "after").write_text(f'[ -e "{taken}" ] || {{ mkdir -p "{taken.parent}"; echo theirs > "{taken}"; }}\n')
        done = site.deliver("institute")
        assert done.returncode != 0 and "not overwritten" in done.stdout and taken.read_text() == "theirs\n", done.stdout
        taken.unlink()
        (config.parent / "after").unlink()
        done = site.deliver("institute")
        assert done.returncode == 0, done.stdout
        assert (there / "demo").stat().st_mode & 0o7777 == 0o2770 and not list(there.rglob(".starmesh-part"))
        is_whole(site, files(there))
        done = site.deliver("institute")
        assert done.returncode == 0 and " 0 sent" in done.stdout, done.stdout
        first = next(there.rglob("*.fits"))
        first.write_bytes(b"changed")
        done = site.run("night", "verify", "last", "--to", "institute")
        assert done.returncode != 0 and first.name in done.stdout, done.stdout
        assert site.deliver("institute").returncode != 0 and first.read_bytes() == b"changed"
    done = site.deliver("institute")
    assert done.returncode != 0 and "look at the network" in done.stdout, done.stdout


def test_a_night_goes_to_an_rsync_daemon_and_its_password_is_nowhere(site, tmp_path):
    there, port = tmp_path / "there", free_port()
    there.mkdir()
    secrets = tmp_path / "rsyncd.secrets"
    secrets.write_text(f"callisto:{SECRET}\n")
    secrets.chmod(0o600)
    (tmp_path / "rsyncd.conf").write_text(
        f"port = {port}\naddress = 127.0.0.1\nuse chroot = no\nuid = {os.getuid()}\ngid = {os.getgid()}\nlog file = /dev/null\n"
        f"[nights]\npath = {there}\nread only = no\nauth users = callisto\nsecrets file = {secrets}\n")
    site.add(f'[[delivery]]\nname = "daemon"\nrsync = "rsync://callisto@127.0.0.1:{port}/nights"\nsecret_env = "NIGHTS_SECRET"\n')
    with process("rsync", "--daemon", "--no-detach", f"--config={tmp_path}/rsyncd.conf"):
        until(lambda: subprocess.run(["rsync", f"rsync://127.0.0.1:{port}/"], capture_output=True).returncode == 0, 20)
        done = site.run("night", "deliver", "last", env={"NIGHTS_SECRET": "wrong"})
        assert done.returncode != 0 and "secret_file" in done.stdout, done.stdout
        done = site.run("night", "deliver", "last", env={"NIGHTS_SECRET": SECRET})
        assert done.returncode == 0, done.stdout
        assert SECRET not in done.stdout + done.stderr
        is_whole(site, files(there))
        done = site.run("night", "verify", "last", env={"NIGHTS_SECRET": SECRET})
        assert done.returncode == 0, done.stdout
    assert not any(SECRET.encode() in content for content in files(site.folder).values())


def test_a_night_is_exported_with_all_that_is_known_of_it(site):
    site.type(block("sh", "night export"))
    out = site.folder / "night"
    manifest = json.loads((out / "manifest.json").read_text())
    assert len(manifest["files"]) == len(site.frames) == len(list((out / "files").rglob("*.fits")))
    for entry in manifest["files"] + manifest["tables"]:
        content = (out / entry["name"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["sha256"]
    documents = {entry["name"]: entry for entry in manifest["documents"]}
    for name, entry in documents.items():
        content = (out / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["sha256"] and len(content) == entry["bytes"]
    report = json.loads((out / "report.json").read_text())
    assert report["night"] == manifest["night"] and "<html" in (out / "report.html").read_text()
    images = duckdb.sql(f"SELECT file FROM read_parquet('{out}/parquet/images/*/*/*/*.parquet')").fetchall()
    assert {file for (file,) in images} == set(site.frames)
    assert set(files(out)) == {entry["name"] for entry in manifest["files"] + manifest["tables"]} | set(documents) | {"manifest.json"}
    rows = {entry["name"]: entry["rows"] for entry in manifest["tables"]}
    with sqlite3.connect(site.folder / "data/archive.db") as database:
        counted = {name: database.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
                   for name, table in [("guiding.csv", "guiding"), ("facts.csv", "facts"), ("telemetry.csv", "samples")]}
    assert rows["guiding.csv"] == counted["guiding.csv"] > 0 and rows["facts.csv"] == counted["facts.csv"] > 0
    assert counted["telemetry.csv"] >= rows["telemetry.csv"] > 1000 and rows["log.csv"] > 10
    done = site.run("night", "export", "last", "--out", "night")
    assert done.returncode != 0 and "not empty" in done.stderr, done.stderr


def test_the_networks_archive_may_be_a_bucket_and_a_database_is_made_from_it(site, store):
    document = (PROJECT / "docs/operator/archive.md").read_text()
    text = next(text for text in re.findall(r"^```toml\n(.*?)^```$", document, flags=re.M | re.S) if "[archive.parquet]" in text)
    site.add(text.replace("https://s3.example.org", f"http://127.0.0.1:{store.proxy.server_port}"))
    (site.folder / "network.secret").write_text(SECRET)
    done = site.run("night", "parquet", "--all")
    assert done.returncode != 0 and "make the bucket" in done.stderr, done.stderr
    store.client().create_bucket(Bucket="network")
    written = site.run("night", "parquet", "--all")
    assert written.returncode == 0 and SECRET not in written.stdout + written.stderr, written.stderr
    objects = store.objects("network")
    assert objects and all(re.fullmatch(r"archive/\w+/site=\w+/telescope=\w+/night=\d{8}/part-0\.parquet", key) for key in objects)
    again = site.run("night", "parquet", "--all")
    assert "0 written, 0 changed" in again.stdout and store.objects("network") == objects, again.stdout
    # a row that changed: its night is written again, and keeps what the database has no more
    with sqlite3.connect(site.folder / "data/archive.db") as database:
        database.execute("DELETE FROM facts")
        database.execute("UPDATE images SET bytes = bytes + 1")
    changed = site.run("night", "parquet", "--all")
    assert changed.returncode == 0 and "0 changed" not in changed.stdout, changed.stdout
    # what `aws s3 sync` brings, as the document says
    folder = site.folder / "network"
    for key, content in store.objects("network").items():
        path = folder / key.removeprefix("archive/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    facts = duckdb.sql(f"SELECT count(*) FROM read_parquet('{folder}/facts/*/*/*/*.parquet')").fetchall()[0][0]
    assert facts > 0, "rows that the database has no more stay"
    done = site.run("archive", "rebuild", "--from", "network", "--into", "other.db")
    assert done.returncode == 0, done.stderr
    with sqlite3.connect(site.folder / "other.db") as database:
        assert dict(database.execute("SELECT file, frame_id FROM images")) == site.frames
    # a store that lies, and one that cannot be reached
    store.mode = "lies"
    with sqlite3.connect(site.folder / "data/archive.db") as database:
        database.execute("UPDATE images SET bytes = bytes + 1")
    done = site.run("night", "parquet", "--all")
    assert done.returncode != 0 and "gives back other bytes" in done.stderr, done.stderr
    store.proxy.shutdown()
    store.proxy.server_close()
    done = site.run("night", "parquet", "--all")
    assert done.returncode != 0 and "cannot be reached" in done.stderr and SECRET not in done.stderr, done.stderr
