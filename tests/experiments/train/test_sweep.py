"""The sweep: variants differ in one thing and see equally many garments; the best comes first."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from experiments.train.sweep import VARIANTS, Variant, _loop, draw, markdown


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_differs_from_the_first_in_one_thing(name: str) -> None:
    first, variant = asdict(Variant()), asdict(VARIANTS[name])
    changed = {key for key in first if variant[key] != first[key]}
    # Another optimiser wants another learning rate.
    assert len(changed - {"optimiser"} if "learning_rate" in changed else changed) == (name != "small")


@pytest.mark.parametrize("name", VARIANTS)
def test_all_see_as_many_garments(name: str) -> None:
    variant = VARIANTS[name]
    assert _loop(variant, 300).steps * variant.garments == 1200


def test_the_best_comes_first(tmp_path: Path) -> None:
    rows: list[dict[str, Any]] = [
        {"variant": name, "parameters": 1000, "steps": 10, "validation_mm": error, "seconds": 3.2}
        for name, error in (("small", 5.0), ("order 3", 4.0), ("silu", 6.0))
    ]
    found = {"variants": rows}
    table = [line for line in markdown(found) if line.startswith("| ")]
    assert [line.split(" | ")[0].strip("| ") for line in table[1:]] == ["order 3", "small", "silu"]
    draw(tmp_path / "sweep.png", found)
    assert (tmp_path / "sweep.png").exists()
