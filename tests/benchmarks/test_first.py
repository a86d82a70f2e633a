"""The first drape of a process, measured on a program that costs what is known."""

import sys
from pathlib import Path

import pytest

from benchmarks import first
from tryon_jax.files.compile_cache import VARIABLE


def test_a_process_is_told_what_to_do_and_its_time_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "python"
    seen = tmp_path / "seen.txt"
    lines = (
        "import os, sys, time",
        f"words = ' '.join(sys.argv[1:]) + ' in ' + os.environ[{VARIABLE!r}]",
        f"open({str(seen)!r}, 'w').write(words)",
        "while time.process_time() < 0.4: pass",
    )
    program.write_text("\n".join((f"#!{sys.executable}", *lines)) + "\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    wall, cpu = first.run(["--out", "dress.glb"], "folder")
    assert 0.3 <= cpu < 3.0
    assert wall > 0.25
    assert seen.read_text() == "-m tryon_jax drape --out dress.glb in folder"
    row = first.measure(["--out", "dress.glb"], "", first.Config(repeats=1))
    assert row["processor, s"] >= 0.3
