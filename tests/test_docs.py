"""Every code block of the README and of the documentation runs; blocks of one file share their names."""

import itertools
import os
import re
import shlex
from pathlib import Path

import pytest

from tryon_jax.cli import main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path, *languages: str) -> list[str]:
    return [text for language, text in FENCE.findall(page.read_text(encoding="utf-8")) if language in languages]


def tryon_commands(page: Path) -> list[str]:
    """Lines that run `tryon`, continued lines joined, whatever directory the program is in."""
    text = "\n".join(blocks(page, "bash", "sh", "console")).replace("\\\n", " ")
    return [line.strip() for line in text.splitlines() if re.match(r"\s*(\S*/)?tryon\s", line)]


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.name)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for number, source in enumerate(blocks(page, "python"), start=1):
        exec(compile(source, f"{page.name}, block {number}", "exec"), names)


@pytest.mark.parametrize("page", [p for p in PAGES if tryon_commands(p)], ids=lambda p: p.name)
def test_commands_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for line in tryon_commands(page):
        arguments = shlex.split(line, comments=True)[1:]
        assert main(arguments) == 0, f"{line}\n{capsys.readouterr().err}"
        for option, value in itertools.pairwise(arguments):
            if option in ("--out", "--picture", "--report"):
                assert os.path.exists(value), f"{line} did not write {value}"


def test_links_between_pages_lead_somewhere():
    broken = [
        f"{page.name}: {target}"
        for page in PAGES
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert broken == []
