#!/usr/bin/env python3
"""How fast DuckDB answers the questions of docs/parquet.md from generated nights; see README.md in this folder.

    target/venv/bin/python tests/bench/parquet.py [TELESCOPES NIGHTS]      # 6 365: some 64 million rows, 600 MB in the folder for temporary files
"""

import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

import duckdb

PROJECT = pathlib.Path(__file__).resolve().parents[2]
RUNS = 5


def main() -> None:
    telescopes, nights = sys.argv[1:] or ["6", "365"]
    with tempfile.TemporaryDirectory(prefix="starmesh-bench-") as folder:
        network = pathlib.Path(os.environ.get("NETWORK", f"{folder}/network"))
        if not network.exists():
            command = ["cargo", "run", "--release", "--quiet", "--locked", "-p", "parquet_nights", "--example", "year", "--"]
            subprocess.run([*command, str(network), telescopes, nights], cwd=PROJECT, check=True)
        files = [file for file in network.rglob("*.parquet")]
        print(f"{len(files)} files, {sum(file.stat().st_size for file in files) / 1e6:.0f} MB, load {os.getloadavg()[0]:.1f}")
        for sql in re.findall(r"```sql\n(.*?)```", (PROJECT / "docs/parquet.md").read_text(), re.S):
            tables = set(re.findall(r"network/(\w+)/", sql))
            if not all((network / table).exists() for table in tables):
                continue  # the generator writes no single values
            took = []
            for _ in range(RUNS):
                with duckdb.connect() as connection:
                    began = time.perf_counter()
                    rows = connection.sql(sql.replace("'network/", f"'{network}/")).fetchall()
                    took.append(time.perf_counter() - began)
            print(f"{' and '.join(sorted(tables))}: median {statistics.median(took):.2f} s, slowest {max(took):.2f} s; {len(rows)} rows")


if __name__ == "__main__":
    main()
