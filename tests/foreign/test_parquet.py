"""The network's archive read by a program that we did not write: PyPI duckdb.

What a demo's night left is compared with its database, value by value; every query of docs/parquet.md is run on it and on generated nights of six
telescopes; and a database is made from the files. Writers are killed and their disks are full.
"""

import os
import pathlib
import random
import re
import resource
import signal
import sqlite3
import subprocess
import time

import duckdb
import pytest

PROJECT = pathlib.Path(__file__).resolve().parents[2]
TELESCOPES, NIGHTS, FRAMES = 6, 3, 300


@pytest.fixture(scope="module")
def demo(starmesh, tmp_path_factory) -> pathlib.Path:
    """What a whole simulated night of the four nodes left."""
    folder = tmp_path_factory.mktemp("demo") / "night"
    done = subprocess.run([starmesh, "demo", "--speed", "600", "--size-px", "512", "--keep", str(folder)],
                          capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def network(starmesh, demo, tmp_path_factory) -> pathlib.Path:
    """The folder that has `network`: the demo's nights, and those of six generated telescopes."""
    folder = tmp_path_factory.mktemp("archive")
    shown = parquet(starmesh, demo, folder / "network", "--all")
    assert re.search(r"\d{8} +\d+ +[\d.]+  \d+ written, 0 changed, 0 as before", shown), shown
    command = ["cargo", "run", "--quiet", "--locked", "-p", "parquet_nights", "--example", "year", "--",
               str(folder / "network"), str(TELESCOPES), str(NIGHTS)]
    subprocess.run(command, cwd=PROJECT, check=True, timeout=900)
    return folder


def parquet(starmesh, demo, out, *arguments: str, ok: bool = True, **options) -> str:
    command = [starmesh, "night", "parquet", *arguments, "--config", str(demo / "observatory.toml"), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, **options)
    assert (done.returncode == 0) == ok, done.stdout + done.stderr
    return done.stdout + done.stderr


def ask(folder: pathlib.Path, sql: str) -> list[dict]:
    """Rows of DuckDB's answer, with the folder `network` where the documents have it."""
    with duckdb.connect() as connection:
        connection.sql("SET TimeZone = 'UTC'")
        answer = connection.sql(sql.replace("'network/", f"'{folder}/network/"))
        return [dict(zip(answer.columns, row)) for row in answer.fetchall()]


def queries() -> list[str]:
    return re.findall(r"```sql\n(.*?)```", (PROJECT / "docs/parquet.md").read_text(), re.S)


def stored(database: pathlib.Path, sql: str) -> list[tuple]:
    with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
        return connection.execute(sql).fetchall()


def of_demo(table: str) -> str:
    return f"read_parquet('network/{table}/site=demo/*/*/*.parquet', hive_partitioning = true)"


def test_every_table_has_what_the_database_has(demo, network):
    database = demo / "data/archive.db"
    tables = {"telemetry": "samples", "focus_runs": "focus_runs", "focus_points": "focus_points"} | {
        name: name for name in ["minutes", "images", "facts", "guiding", "log", "audit", "states", "schedule_rows", "alerts",
                                "series_stars", "fluxes"]}
    rows = {}
    for table, source in tables.items():
        expected = stored(database, f"SELECT count(*) FROM {source}")[0][0]
        if expected:
            rows[table] = expected
            assert ask(network, f"SELECT count(*) AS rows FROM {of_demo(table)}") == [{"rows": expected}], table
    assert rows.keys() >= {"telemetry", "minutes", "images", "facts", "guiding", "log", "audit", "states", "schedule_rows"}, rows
    nights = ask(network, f"SELECT table_name, sum(rows) AS rows FROM {of_demo('nights')} GROUP BY ALL")
    assert {row["table_name"]: row["rows"] for row in nights} == rows


def test_values_have_their_types_and_times(demo, network):
    database = demo / "data/archive.db"
    polled = stored(database, """SELECT device_type, device_name, device_command, at_us, value_type, value FROM samples
        JOIN series ON id = series ORDER BY 1, 2, 3, 4""")
    read = ask(network, f"""SELECT device_type, device_name, property, epoch_us(polled_at) AS at_us, value_type, number, integer, text, reason
        FROM {of_demo('telemetry')} ORDER BY 1, 2, 3, 4""")
    words, places = ["none", "bool", "int", "float", "text", "list"], ["reason", "integer", "integer", "number", "text", "text"]
    assert len(read) == len(polled) > 500
    for (kind, name, command, at_us, value_type, value), row in zip(polled, read):
        assert (kind, name, command, at_us) == (row["device_type"], row["device_name"], row["property"], row["at_us"])
        assert row["value_type"] == words[value_type] and row[places[value_type]] == value, row
    assert {row["value_type"] for row in read} >= {"bool", "int", "float"}
    # a time of the database is text, and of the files a time
    written = stored(database, "SELECT frame_id, date_obs FROM images ORDER BY 1")
    times = ask(network, f"SELECT frame_id, strftime(date_obs, '%Y-%m-%d %H:%M:%S.%f') AS at FROM {of_demo('images')} ORDER BY 1")
    assert [tuple(row.values()) for row in times] == written


def test_every_query_of_the_document_has_an_answer(demo, network):
    asked = queries()
    assert len(asked) == 5
    nights, weather, seeing, frames, values = (ask(network, sql) for sql in asked[:4] + [asked[4].replace("20261121", "20260102")])
    assert len(nights) >= 1 and nights[0]["site"] == "demo" and nights[0]["rows"] > 1000
    # the generated stars are wider in the wind, by 0.05 arcsec for each m/s; at the demo's speed few minutes are polled, so few frames have one
    measured = stored(demo / "data/archive.db", "SELECT count(*) FROM facts WHERE fwhm_px IS NOT NULL")[0][0]
    assert TELESCOPES * NIGHTS * FRAMES <= sum(row["frames"] for row in weather) <= TELESCOPES * NIGHTS * FRAMES + measured
    assert weather[-1]["fwhm_arcsec"] > weather[0]["fwhm_arcsec"], weather
    generated = """SELECT corr(mean, fwhm_px) AS corr, regr_slope(fwhm_px * scale_arcsec_px, mean) AS slope
        FROM read_parquet('network/facts/site=paranal/*/*/*.parquet', hive_partitioning = true) AS facts
        JOIN read_parquet('network/minutes/site=paranal/*/*/*.parquet', hive_partitioning = true) AS minutes USING (telescope, night)
        WHERE property = 'WindSpeed' AND minute = date_trunc('minute', date_obs)"""
    found = ask(network, generated)[0]
    assert 0.045 < found["slope"] < 0.055 and found["corr"] > 0.5, found
    pairs = TELESCOPES * (TELESCOPES - 1) // 2
    assert len(seeing) == pairs and all(row["pairs"] == NIGHTS * FRAMES // 5 and row["one"] < row["two"] for row in seeing), seeing
    assert len(frames) == 100 and all(row["exposure_s"] > 0 for row in frames)
    assert values == []  # generated nights have no single values; those of the demo's night:
    night = ask(network, f"SELECT max(night) AS night FROM {of_demo('telemetry')}")[0]["night"]
    humidity = ask(network, asked[4].replace("20261121", str(night)))
    assert len(humidity) > 1 and all(0 <= row["number"] <= 100 for row in humidity)


def test_frames_of_the_demo_are_found_with_their_files_and_quality(demo, network):
    frames = ask(network, f"""SELECT images.file, images.object, images.exposure_s, facts.stars FROM {of_demo('images')} AS images
        JOIN {of_demo('facts')} AS facts USING (frame_id) WHERE images.image_type = 'Light Frame' AND facts.stars > 0""")
    assert len(frames) > 3
    for frame in frames:
        assert (demo / "images" / frame["file"]).is_file() and frame["object"] and frame["exposure_s"] > 0


def test_frames_of_the_demo_have_the_weather_that_was_polled_last_before_them(demo, network):
    frames = ask(network, f"""SELECT facts.frame_id, date_obs, polled_at, number AS wind_mps, fwhm_px FROM {of_demo('facts')} AS facts
        ASOF JOIN (FROM {of_demo('telemetry')} WHERE property = 'WindSpeed' AND number IS NOT NULL) AS wind
        ON date_obs >= polled_at WHERE fwhm_px IS NOT NULL""")
    measured = stored(demo / "data/archive.db", "SELECT count(*) FROM facts WHERE fwhm_px IS NOT NULL")[0][0]
    assert len(frames) == measured > 0
    assert all(0 <= row["wind_mps"] < 100 and (row["date_obs"] - row["polled_at"]).total_seconds() < 7200 for row in frames)


def test_a_database_is_made_again_and_is_the_same(starmesh, demo, network, tmp_path):
    made, before = tmp_path / "made.db", demo / "data/archive.db"
    command = [starmesh, "archive", "rebuild", "--from", str(network / "network"), "--config", str(demo / "observatory.toml")]
    done = subprocess.run([*command, "--into", str(made)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    series = "JOIN series ON id = series ORDER BY device_type, device_name, device_command, telescope,"
    for sql in [f"SELECT device_type, device_name, device_command, telescope, at_us, value_type, value FROM samples {series} at_us",
                f"""SELECT device_type, device_name, device_command, telescope, minute, polled, missing, minimum, mean, maximum, last_us, last
                    FROM minutes {series} minute""",
                "SELECT * FROM audit ORDER BY rowid", "SELECT * FROM days ORDER BY 1",
                *[f"SELECT * FROM {table} ORDER BY 1, 2, 3, 4, 5" for table in ["images", "facts", "guiding", "log", "focus_runs", "focus_points"]]]:
        assert stored(made, sql) == stored(before, sql), sql
    assert stored(made, "PRAGMA integrity_check") == [("ok",)]
    again = subprocess.run([*command, "--into", str(made)], capture_output=True, text=True, timeout=60)
    assert again.returncode != 0 and "never overwritten" in again.stderr, again.stderr


def test_a_writer_that_is_killed_leaves_whole_files_and_the_next_one_ends_its_work(starmesh, demo, tmp_path):
    whole = {}
    chance = random.Random(98)
    for _ in range(12):
        command = [starmesh, "night", "parquet", "--all", "--config", str(demo / "observatory.toml"), "--out", str(tmp_path / "network")]
        writer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(chance.uniform(0.0, 0.3))
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        for file in (tmp_path / "network").rglob("*.parquet"):
            assert file.name == "part-0.parquet"
            rows = duckdb.sql(f"SELECT count(*) FROM read_parquet('{file}')").fetchall()
            assert whole.setdefault(file, rows) == rows
    assert "0 changed" in parquet(starmesh, demo, tmp_path / "network", "--all")
    assert "0 written, 0 changed" in parquet(starmesh, demo, tmp_path / "network", "--all")
    # what a killed writer left has another ending, and goes when it is an hour old
    left = next((tmp_path / "network/images").rglob("part-0.parquet")).with_name("part-0.parquet.part-1")
    left.write_bytes(b"PAR1")
    os.utime(left, (time.time() - 7200,) * 2)
    parquet(starmesh, demo, tmp_path / "network", "--all")
    assert not left.exists()


def test_a_full_disk_is_reported_and_nothing_is_overwritten(starmesh, demo, tmp_path):
    def small_files():
        # a write beyond this is refused, as by a full disk
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    out = tmp_path / "network"
    shown = parquet(starmesh, demo, out, "--all", ok=False, preexec_fn=small_files)
    assert "part-0.parquet" in shown and "could not be written as Parquet" in shown, shown
    assert not list(out.rglob("*.part-*"))
    parquet(starmesh, demo, out, "--all")
    before = {file: file.read_bytes() for file in out.rglob("*.parquet")}
    assert len(before) >= 8
    made = tmp_path / "made.db"
    command = [starmesh, "archive", "rebuild", "--from", str(out), "--config", str(demo / "observatory.toml"), "--into", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, preexec_fn=small_files)
    assert done.returncode != 0 and not list(tmp_path.glob("made.db*")), done.stderr
    assert before == {file: file.read_bytes() for file in out.rglob("*.parquet")}


def test_wrong_commands_say_what_to_do(starmesh, demo, tmp_path):
    config = ["--config", str(demo / "observatory.toml")]
    for arguments, words in [
        (["night", "parquet", "20010101", "--out", str(tmp_path / "n")], "has nothing of the night 20010101"),
        (["night", "parquet", "--all"], "use --out DIR, or `parquet` in [archive]"),
        (["night", "parquet", "yesterday", "--out", str(tmp_path / "n")], "is no night"),
        (["archive", "rebuild", "--from", str(tmp_path / "n")], "never overwritten"),
        (["archive", "rebuild", "--from", str(tmp_path / "n"), "--into", str(tmp_path / "x.db")], "has no night of demo/alpha"),
    ]:
        done = subprocess.run([starmesh, *arguments, *config], capture_output=True, text=True, timeout=60)
        assert done.returncode != 0 and words in done.stderr, (arguments, done.stderr)
    assert not (tmp_path / "n").exists()
