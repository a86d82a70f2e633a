"""What `import tryon_jax` gives, and what it does not load."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import tryon_jax as tj


@pytest.mark.parametrize("name", tj.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(tj, name).__name__ == name
    assert name in dir(tj)


def test_type_checkers_and_programs_are_told_the_same() -> None:
    tree = ast.parse(Path(str(tj.__file__)).read_text(encoding="utf-8"))
    imported = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert imported == tj._HOMES
    assert sorted(imported) == sorted(tj.__all__)


def test_an_unknown_name_is_named() -> None:
    with pytest.raises(AttributeError, match="no attribute 'drap'"):
        tj.__getattr__("drap")


def test_the_package_alone_loads_no_jax() -> None:
    script = "import sys, tryon_jax; assert not {'jax', 'scipy', 'trimesh'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_a_drape_loads_no_statistics_and_no_optimiser() -> None:
    script = "import sys, tryon_jax as tj; tj.drape; tj.prepare; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout.split()
    assert "jax" in loaded
    assert not {"scipy.stats", "optimistix", "optax", "viser", "matplotlib"} & set(loaded)
