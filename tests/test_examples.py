"""Every example runs and shows what it says."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested():
    source = Path(__file__).read_text(encoding="utf-8")
    assert all(f'load("{path.stem}")' in source for path in EXAMPLES.glob("*.py"))


def test_many_bodies():
    vertices = load("many_bodies").main(count=3)
    assert vertices.shape[0] == 3
    assert np.isfinite(vertices).all()
    assert np.abs(vertices[0] - vertices[1]).max() > 0.005


@pytest.mark.slow
def test_gradient_of_fit():
    effect = load("gradient_of_fit").main()
    assert effect["chest"] > 0, "a wider garment hangs farther from the body"
    assert effect["chest"] > effect["sleeve_length"]


@pytest.mark.slow
def test_recover_design():
    truth, found = load("recover_design").main()
    np.testing.assert_allclose(found, truth, atol=0.05)


@pytest.mark.slow
def test_drape_in_training():
    before, after = load("drape_in_training").main(steps=40)
    assert after < 0.5 * before


@pytest.mark.slow
def test_own_garment():
    before, after = load("own_garment").main()
    assert before.shape == after.shape
    assert 0 < np.linalg.norm(after - before, axis=1).max() < 0.1
