"""Every code block of the README and of the documentation runs; blocks of one file share their names.

Pictures are drawn small, `tryon view` gets ready and ends, and of experiments, which take hours, the options are read.
"""

import importlib
import itertools
import os
import re
import shlex
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import tyro
from test_examples import load as load_example

import tryon_jax
from tryon_jax.body import load_body
from tryon_jax.cli import find_commands, main
from tryon_jax.files.export import mesh_part, write_mesh

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MADE = ("simulator.md", "RESULTS.md", "BENCHMARKS.md", "cost.md")
"""Pages that programs write: they are there once these were run."""


def blocks(page: Path, *languages: str) -> list[str]:
    return [text for language, text in FENCE.findall(page.read_text(encoding="utf-8")) if language in languages]


def shell_lines(page: Path, pattern: str) -> list[str]:
    """Lines of the shell blocks that match, continued lines joined."""
    text = "\n".join(blocks(page, "bash", "sh", "console")).replace("\\\n", " ")
    return [line.strip() for line in text.splitlines() if re.match(rf"\s*{pattern}\s", line)]


def tryon_commands(page: Path) -> list[str]:
    """Lines that run `tryon`, whatever directory the program is in."""
    return shell_lines(page, r"(\S*/)?tryon")


def slowly(pages: list[Path]) -> list:
    """Pages whose blocks are run; all but the README's take more than a few seconds."""
    return [pytest.param(p, marks=[pytest.mark.slow] if p.parent.name == "docs" else [], id=p.name) for p in pages]


@pytest.mark.parametrize("page", slowly([p for p in PAGES if blocks(p, "python")]))
def test_python_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for number, source in enumerate(blocks(page, "python"), start=1):
        exec(compile(source, f"{page.name}, block {number}", "exec"), names)


@pytest.mark.parametrize("page", slowly([p for p in PAGES if tryon_commands(p)]))
def test_commands_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for line in tryon_commands(page):
        arguments = shlex.split(line, comments=True)[1:]
        given = dict(itertools.pairwise(arguments))
        provide(given)
        if arguments[0] == "view":
            viewer = pytest.importorskip("tryon_jax.viewer")
            monkeypatch.setattr(viewer, "serve", served)
        elif "--picture" in given and arguments[0] != "pattern":
            arguments += ["--height", "60"]
        assert main(arguments) == 0, f"{line}\n{capsys.readouterr().err}"
        for option in ("--out", "--picture", "--report"):
            assert option not in given or os.path.exists(given[option]), f"{line} did not write {given[option]}"


def provide(given: dict[str, str]) -> None:
    """Put files in place that a reader of the page would have."""
    if "--weights" in given:
        Path(given["--weights"]).parent.mkdir(parents=True, exist_ok=True)
        with resources.as_file(resources.files("tryon_jax") / "data" / "models" / "small.safetensors") as weights:
            shutil.copy(weights, given["--weights"])
    if "--garment" in given:
        write_mesh(given["--garment"], [mesh_part("garment", *load_example("own_garment").tube_dress(12, 24))])
    if given.get("--fabric", "").endswith(".toml"):
        table = resources.files("tryon_jax").joinpath("data/fabrics.toml").read_text()
        Path(given["--fabric"]).write_text("[mine" + table.partition("[royal-target")[2].partition("\n[")[0])
    if "--sizes" in given:
        Path(given["--sizes"]).write_text("name,design,garment_chest\nS,tshirt,0.94\nM,tshirt,1.02\n", encoding="utf-8")
    if "--smpl" in given:
        body = load_body("female")
        np.savez(
            given["--smpl"],
            v_template=body.v_template,
            shapedirs=body.shapedirs,
            J_regressor=body.J_regressor,
            weights=body.lbs_weights,
            kintree_table=np.array([body.parents, np.arange(len(body.parents))]),
            f=body.faces,
        )


class served:
    """Stands in for the server of `tryon view`, which would never end."""

    def __init__(self, _model: object, *, host: str, port: int, **_: object) -> None:
        assert host == "127.0.0.1"
        self.port = port

    def get_port(self) -> int:
        return self.port

    def sleep_forever(self) -> None:
        """Until the test goes on."""


@pytest.mark.parametrize("page", [*PAGES, ROOT / "benchmarks" / "PENDING_GPU.md"], ids=lambda p: p.name)
def test_experiments_and_benchmarks_know_the_options(page):
    lines = shell_lines(page, r"(timeout \d+ )?(\S*/)?python3? -m (experiments|benchmarks)")
    for line in itertools.chain.from_iterable(line.split(" && ") for line in lines):
        words = shlex.split(line, comments=True)
        package, name, *options = words[words.index("-m") + 1 :]
        commands = find_commands(package)
        assert name in commands, line
        module = importlib.import_module(commands[name].module)
        tyro.cli(module.Config, args=options, config=(tyro.conf.DisallowNone, tyro.conf.OmitArgPrefixes))


def test_links_between_pages_lead_somewhere():
    broken = [
        f"{page.name}: {target}"
        for page in PAGES
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists() and Path(target).name not in MADE
    ]
    assert broken == []


def test_the_reference_has_every_public_name():
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"auto(?:function|class):: tryon_jax\.(\w+)$", text, re.MULTILINE))
    assert documented == set(tryon_jax.__all__)


def test_the_files_that_contributors_are_sent_to_exist():
    text = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
    table = text[text.index("## Where to change what") : text.index("## What we write ourselves")]
    library = Path(tryon_jax.__file__).parent.parent
    for name in re.findall(r"`((?:tryon_jax|experiments|benchmarks|body)/[\w./]*)`", table):
        places = (ROOT / name, library / name, library / "tryon_jax" / name)
        assert any(place.exists() for place in places), name
