"""Write constraints.txt: the newest set of dependencies that pip resolves, exact, for the oldest and newest Python.

    python tools/lock.py python3.11 python3.13

Each argument is an interpreter with pip. Versions that differ between them get environment markers, with the first
interpreter's for every Python below the second's boundary of 3.12.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXTRAS = "pictures,viewer,dev,docs"


def resolve(python: str) -> dict[str, str]:
    """Name and version of everything that pip would install for tryon_jax with all extras but cuda."""
    command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    done = subprocess.run([*command, f"{ROOT}[{EXTRAS}]"], check=True, capture_output=True, text=True)
    report = json.loads(done.stdout)
    found = {}
    for item in report["install"]:
        name = re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower()
        if name != "tryon-jax":
            found[name] = item["metadata"]["version"]
    return found


def merge(older: dict[str, str], newer: dict[str, str]) -> list[str]:
    """Constraint lines, with markers where the two differ."""
    lines = []
    for name in sorted(older | newer):
        if older.get(name) == newer.get(name):
            lines.append(f"{name}=={older[name]}")
            continue
        if name in older:
            lines.append(f'{name}=={older[name]} ; python_version < "3.12"')
        if name in newer:
            lines.append(f'{name}=={newer[name]} ; python_version >= "3.12"')
    return lines


def main() -> None:
    """Resolve for both interpreters and write the file."""
    older, newer = (resolve(python) for python in sys.argv[1:3])
    lines = ["# Made by tools/lock.py; .ci/run installs exactly these.", *merge(older, newer)]
    (ROOT / "constraints.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"constraints.txt: {len(lines) - 1} lines")


if __name__ == "__main__":
    main()
