#!/usr/bin/env python3
"""How many bytes of scripts a browser fetches for the first page: index.html and what its modules import, from one to the next.

Reads the assets as they are built into the web node; what is imported only when a page needs it (`import()`) is counted apart. Standard library
only; `python3 tests/bench/first_load.py`.
"""

import gzip
import pathlib
import posixpath
import re

ASSETS = pathlib.Path(__file__).resolve().parents[2] / "node-web" / "src" / "assets"
MOST = 200_000
STATIC = re.compile(r"""(?:^|[;}\s])(?:import|export)\s*(?:[\w$*{}\s,]+?\s*from\s*)?["'](\.{1,2}/[^"']+)["']""")
LATER = re.compile(r"""\bimport\(\s*["'](\.{1,2}/[^"']+)["']""")


def reached(first: list[str], pattern: re.Pattern) -> list[str]:
    """The scripts that these load, each once."""
    found, ahead = [], list(first)
    while ahead:
        name = ahead.pop(0)
        if name in found:
            continue
        found.append(name)
        text = (ASSETS / name).read_text()
        ahead += [posixpath.normpath(posixpath.join(posixpath.dirname(name), path)) for path in pattern.findall(text)]
    return found


def main():
    page = (ASSETS / "index.html").read_text()
    entries = re.findall(r'<script[^>]* src="/assets/([^"]+\.js)"', page)
    entries += re.findall(r'<link[^>]* rel="modulepreload"[^>]* href="/assets/([^"]+\.js)"', page)
    scripts = reached(entries, STATIC)
    later = sorted({posixpath.normpath(posixpath.join(posixpath.dirname(name), path))
                    for name in scripts for path in LATER.findall((ASSETS / name).read_text())} - set(scripts))
    sizes = {name: (ASSETS / name).stat().st_size for name in scripts}
    packed = sum(len(gzip.compress((ASSETS / name).read_bytes(), 6)) for name in scripts)
    print("| work | Starmesh | to reach |\n|---|---|---|")
    print(f"| scripts of the first load, bytes | {sum(sizes.values())} in {len(sizes)} files ({packed} if they were compressed) | {MOST} |")
    print(f"| scripts that come when a page needs them, bytes | {sum((ASSETS / name).stat().st_size for name in later)} in {len(later)} files | |")
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:8]:
        print(f"  {size:7} {name}")
    raise SystemExit(sum(sizes.values()) > MOST)


if __name__ == "__main__":
    main()
