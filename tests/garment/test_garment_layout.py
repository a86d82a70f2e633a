"""Layout files: the built-in one is sound, and faults of others are named."""

import copy
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tryon_jax.garment import curves, load_layout
from tryon_jax.garment.layout_check import check_drawing, check_layout
from tryon_jax.garment.layout_file import builtin_layouts, parse_layout

TEXT = (resources.files("tryon_jax") / "data" / "layouts" / "kimono.toml").read_text(encoding="utf-8")
KIMONO = load_layout("kimono")

# One rectangle before and one behind, sewn at the sides, open at top and bottom.
TUBE = """
name = "tube"
[parameters.width]
minimum = 0.3
mean = 0.4
maximum = 0.5
[points]
top_left = ["width / 2", 0]
top_right = ["-width / 2", 0]
bottom_left = ["width / 2", -0.5]
bottom_right = ["-width / 2", -0.5]
[edges.top]
path = [["line", "top_left", "top_right"]]
[edges.left]
path = [["line", "top_left", "bottom_left"]]
[edges.right]
path = [["line", "top_right", "bottom_right"]]
[edges.bottom]
path = [["line", "bottom_left", "bottom_right"]]
[panels.front]
side = "front"
outline = ["-bottom", "-left", "top", "right"]
[panels.back]
side = "back"
outline = ["-bottom", "-left", "top", "right"]
[seams]
left = ["front.left", "back.left"]
right = ["front.right", "back.right"]
[loops]
top = ["front.top", "back.top"]
bottom = ["front.bottom", "back.bottom"]
"""


def tube(change: Callable[[dict[str, Any]], object] = lambda _: None) -> dict[str, Any]:
    data = copy.deepcopy(tomllib.loads(TUBE))
    change(data)
    return data


def test_the_builtin_layout_is_sound() -> None:
    assert builtin_layouts() == ["kimono"]
    check_layout(KIMONO)


@st.composite
def any_values(draw: st.DrawFn) -> dict[str, float]:
    return {p.name: draw(st.floats(p.minimum, p.maximum)) for p in KIMONO.parameters}


@given(any_values())
def test_every_drawing_can_be_cut_and_sewn(values: dict[str, float]) -> None:
    check_drawing(KIMONO, values)


@given(any_values())
def test_parameters_are_what_they_say(values: dict[str, float]) -> None:
    drawn = KIMONO.draw(values)
    points = KIMONO.named_points(values)
    assert 4 * points["underarm"][0] == pytest.approx(values["chest"])
    assert -drawn["hem"][:, 1].min() == pytest.approx(values["length"])
    assert -drawn["neck_front"][:, 1].min() == pytest.approx(values["neck_depth"])
    assert points["cuff_top"][0] - points["shoulder"][0] == pytest.approx(values["sleeve_length"])


@given(any_values())
def test_left_and_right_are_mirror_images(values: dict[str, float]) -> None:
    drawn = KIMONO.draw(values)
    for edge in ("overarm", "cuff", "side"):
        np.testing.assert_array_equal(drawn[edge + "_left"] * [-1, 1], drawn[edge + "_right"])
    for edge in ("hem", "neck_front", "neck_back"):
        np.testing.assert_allclose(drawn[edge] * [-1, 1], drawn[edge][::-1], atol=1e-12)


def test_the_hem_covers_the_hip_and_the_neck_goes_round_the_neck() -> None:
    """Body of the embedded woman: hip 1.05 m round, neck 0.35 m round; knits stretch over the head."""
    means = {p.name: p.mean for p in KIMONO.parameters}
    dress = KIMONO.draw(means | {"length": 0.95})
    assert 2 * curves.length(dress["hem"]) > 1.10
    necks = curves.length(dress["neck_front"]) + curves.length(dress["neck_back"])
    assert 0.42 < necks < 0.60


def test_a_layout_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "tube.toml"
    path.write_text(TUBE)
    layout = load_layout(path)
    assert layout.name == "tube"
    assert not layout.builtin
    outline = layout.panel_outline(layout.panels[0], layout.draw({"width": 0.4}))
    assert curves.polygon_area(outline) == pytest.approx(0.2)


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "unknown table": (lambda d: d.update(colour={}), "unknown entry of tube 'colour'"),
    "no seams": (lambda d: d.pop("seams"), r"the table \[seams\] is missing"),
    "range": (lambda d: d["parameters"]["width"].update(mean=0.6), "minimum < mean < maximum"),
    "no number": (lambda d: d["parameters"]["width"].pop("mean"), "needs a number for mean"),
    "parameter entry": (lambda d: d["parameters"]["width"].update(maximun=1), "did you mean 'maximum'"),
    "parameter table": (lambda d: d["parameters"].update(width=0.4), "needs minimum, mean and maximum"),
    "point": (lambda d: d["points"].update(top_left=["1"]), "point 'top_left' needs two expressions"),
    "expression": (lambda d: d["points"].update(top_left=["open('x')", 0]), "point 'top_left': unknown function"),
    "unknown point": (lambda d: d["edges"]["top"].update(path=[["line", "top_left", "tip"]]), "unknown point"),
    "unknown segment": (lambda d: d["edges"]["top"].update(path=[["arc", "top_left"]]), "unknown segment"),
    "points of segment": (lambda d: d["edges"]["top"].update(path=[["cubic", "top_left"]]), "a cubic needs 4 points"),
    "broken path": (
        lambda d: d["edges"]["top"].update(
            path=[["line", "top_left", "top_right"], ["line", "bottom_left", "top_right"]]
        ),
        "ends at 'top_right' and the next starts at 'bottom_left'",
    ),
    "empty path": (lambda d: d["edges"]["top"].update(path=[]), "empty path"),
    "path and mirror": (lambda d: d["edges"]["top"].update(mirror_of="left"), "either a path or mirror_of"),
    "mirror of nothing": (lambda d: d["edges"].update(top={"mirror_of": "x"}), "not drawn above it"),
    "unknown edge": (lambda d: d["panels"]["front"].update(outline=["a", "left", "top"]), "unknown edge"),
    "two edges": (lambda d: d["panels"]["front"].update(outline=["left", "top"]), "at least three different edges"),
    "side": (lambda d: d["panels"]["front"].update(side="inside"), "unknown side"),
    "seam member": (lambda d: d["seams"].update(left=["front.left", "back.lefd"]), "did you mean 'back.left'"),
    "three-edge seam": (lambda d: d["seams"].update(left=["front.left"] * 3), "needs a list of two"),
    "edge used twice": (lambda d: d["loops"].update(extra=["front.left"]), "both in seam 'left' and in loop 'extra'"),
    "loose edge": (lambda d: d["loops"].pop("top"), "'back.top' is neither sewn"),
    "preset": (lambda d: d.update(presets={"wide": {"width": 2}}), "preset 'wide' sets width = 2, outside"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_file_are_named(fault: str) -> None:
    change, message = FAULTS[fault]
    with pytest.raises(ValueError, match=message):
        parse_layout(tube(change), "tube")


GEOMETRY: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "crossing": (lambda d: d["points"].update(top_left=["-width", 0]), "crosses itself near u = .*width = 0.4"),
    "clockwise": (
        lambda d: [d["panels"][p].update(outline=["left", "bottom", "-right", "-top"]) for p in ("front", "back")],
        "runs clockwise",
    ),
    "gap": (
        lambda d: (
            d["points"].update(corner=["width / 2 + 0.01", 0]),
            d["edges"].update(left={"path": [["line", "corner", "bottom_left"]]}),
        ),
        "edge 'left' ends 0.0100 m from the start of 'top'",
    ),
    "short edge": (lambda d: d["points"].update(top_left=["-width / 2 + 0.005", 0]), "'top' is shorter than 1 cm"),
    "seam lengths": (
        lambda d: (
            d["points"].update(low=["-width / 2", -0.6]),
            d["edges"].update(
                longer={"path": [["line", "top_right", "low"]]}, under={"path": [["line", "bottom_left", "low"]]}
            ),
            d["panels"]["back"].update(outline=["-under", "-left", "top", "longer"]),
            d["seams"].update(right=["front.right", "back.longer"]),
            d["loops"].update(bottom=["front.bottom", "back.under"]),
        ),
        "seam 'right' do not match: front.right is 0.5000 m long, back.longer is 0.6000 m",
    ),
    "undefined name": (lambda d: d["points"].update(top_left=["height", 0]), "'height' is not defined"),
}


@pytest.mark.parametrize("fault", GEOMETRY)
def test_faults_of_geometry_are_named(fault: str) -> None:
    change, message = GEOMETRY[fault]
    with pytest.raises(ValueError, match=message):
        check_layout(parse_layout(tube(change), "tube"))


def test_a_fault_at_one_end_of_a_range_is_found() -> None:
    data = tube(lambda d: d["points"].update(top_left=["0.4 - width / 2", 0], top_right=["width / 2 - 0.4", 0]))
    parse_layout(data, "tube")
    data["points"]["bottom_left"] = ["0.45 - width", -0.5]
    data["points"]["bottom_right"] = ["width - 0.45", -0.5]
    with pytest.raises(ValueError, match=r"width = 0\.5"):
        check_layout(parse_layout(data, "tube"))


def test_files_that_are_no_layouts(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no file"):
        load_layout(tmp_path / "none.toml")
    with pytest.raises(ValueError, match=r"unknown layout 'kimona'.*did you mean 'kimono'"):
        load_layout("kimona")
    broken = tmp_path / "broken.toml"
    broken.write_text("a = [")
    with pytest.raises(ValueError, match="is not a TOML file"):
        load_layout(broken)
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="is not a TOML file"):
        load_layout(str(broken))
