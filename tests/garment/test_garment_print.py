"""Patterns on paper, as flat meshes and as pictures, and the command that makes them."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from tryon_jax.cli import main
from tryon_jax.garment import load_design_space, remesh
from tryon_jax.garment.curves import first_crossing, inside_polygon, polygon_area
from tryon_jax.garment.panels import GAP, lay_out, picture_pattern, write_panels_obj
from tryon_jax.garment.svg import cutting_line, pattern_svg, write_svg

SPACE = load_design_space()
NAMESPACE = "{http://www.w3.org/2000/svg}"


def outline_of(path: ET.Element) -> np.ndarray:
    numbers = [float(t) for t in path.attrib["d"].replace("Z", "").replace("M", "").replace("L", "").split()]
    return np.array(numbers).reshape(-1, 2)


def test_the_drawing_is_at_scale_one() -> None:
    design = SPACE.preset("dress")
    root = ET.fromstring(pattern_svg(SPACE, design))
    width, height = root.attrib["width"], root.attrib["height"]
    assert width.endswith("mm")
    assert root.attrib["viewBox"] == f"0 0 {width[:-2]} {height[:-2]}"
    for panel in SPACE.layout.panels:
        group = next(g for g in root.iter(NAMESPACE + "g") if g.attrib["id"] == panel.name)
        seam = next(p for p in group.iter(NAMESPACE + "path") if p.attrib["class"] == "seam")
        drawn = SPACE.layout.panel_outline(panel, SPACE.draw(design))
        np.testing.assert_allclose(np.ptp(outline_of(seam), axis=0), 1000 * np.ptp(drawn, axis=0), atol=0.02)
        labels = " ".join(t.text or "" for t in group.iter(NAMESPACE + "text"))
        for word in ("grain line", "hem, 63.4 cm", "side left", "cuff right", panel.name):
            assert word in labels


def test_the_panels_lie_apart_on_the_sheet() -> None:
    root = ET.fromstring(pattern_svg(SPACE, SPACE.preset("tank")))
    cuts = [outline_of(p) for p in root.iter(NAMESPACE + "path") if p.attrib["class"] == "cut"]
    assert len(cuts) == 2
    assert cuts[0][:, 0].max() + 25 < cuts[1][:, 0].min()
    size = np.array([float(x) for x in root.attrib["viewBox"].split()[2:]])
    for cut in cuts:
        assert (cut > 15).all()
        assert (cut < size - 15).all()


@pytest.mark.parametrize("name", SPACE.presets)
def test_the_cutting_line_goes_round_the_seam_line(name: str) -> None:
    drawn = SPACE.draw(SPACE.preset(name))
    for panel in SPACE.layout.panels:
        allowances = {edge: 0.01 for edge, _ in panel.outline}
        cut = cutting_line(panel, drawn, allowances)
        seam = SPACE.layout.panel_outline(panel, drawn)
        assert first_crossing(cut) is None
        assert inside_polygon(cut, seam).all()
        gap = np.linalg.norm(seam[:, None] - cut[None], axis=2).min(axis=1)
        assert gap.max() < 0.02
        # Steiner: a closed strip of width d along a simple outline has area about d times its length.
        around = np.linalg.norm(seam - np.roll(seam, 1, axis=0), axis=1).sum()
        assert polygon_area(cut) - polygon_area(seam) == pytest.approx(0.01 * around, rel=0.05)


def test_no_allowance_is_the_seam_line() -> None:
    drawn = SPACE.draw(SPACE.preset("tshirt"))
    panel = SPACE.layout.panels[0]
    cut = cutting_line(panel, drawn, {edge: 0.0 for edge, _ in panel.outline})
    assert polygon_area(cut) == pytest.approx(polygon_area(SPACE.layout.panel_outline(panel, drawn)), rel=1e-9)


def test_hems_get_more_than_seams_and_necklines_do_not() -> None:
    design = SPACE.preset("tshirt")
    root = ET.fromstring(pattern_svg(SPACE, design, seam_allowance=0.01, hem_allowance=0.03))
    group = next(g for g in root.iter(NAMESPACE + "g") if g.attrib["id"] == "front")
    cut, seam = (
        next(outline_of(p) for p in group.iter(NAMESPACE + "path") if p.attrib["class"] == c) for c in ("cut", "seam")
    )
    assert cut[:, 1].max() - seam[:, 1].max() == pytest.approx(30, abs=0.1)
    middle = (seam[:, 0].min() + seam[:, 0].max()) / 2

    def neck(line: np.ndarray) -> float:
        near = line[abs(line[:, 0] - middle) < 2]
        return float(near[:, 1].min())

    assert neck(seam) - neck(cut) == pytest.approx(10, abs=0.2)


def test_bad_allowances() -> None:
    with pytest.raises(ValueError, match=r"seam_allowance = 0\.2 m is outside its range"):
        pattern_svg(SPACE, SPACE.mean_design, seam_allowance=0.2)
    with pytest.raises(ValueError, match="hem_allowance must be finite"):
        pattern_svg(SPACE, SPACE.mean_design, hem_allowance=float("nan"))


def test_labels_are_escaped() -> None:
    design = SPACE.design("a < b & c", chest=1.0)
    assert "a < b & c" in (ET.fromstring(pattern_svg(SPACE, design)).findtext(NAMESPACE + "title") or "")


def test_files(tmp_path: Path) -> None:
    write_svg(tmp_path / "a.svg", SPACE, SPACE.preset("tank"))
    assert ET.parse(tmp_path / "a.svg").getroot().tag == NAMESPACE + "svg"
    garment = remesh(SPACE, SPACE.preset("tank"), target_area=1e-3)
    flat = lay_out(garment)
    front, back = (flat[garment.uv_panels == k] for k in (0, 1))
    assert back[:, 0].min() - front[:, 0].max() == pytest.approx(GAP)
    assert flat.min() == 0.0
    write_panels_obj(tmp_path / "a.obj", garment)
    lines = (tmp_path / "a.obj").read_text().splitlines()
    assert [line for line in lines if line.startswith("o ")] == ["o front", "o back"]
    assert sum(line.startswith("f ") for line in lines) == len(garment.faces)
    points = np.array([[float(x) for x in line.split()[1:]] for line in lines if line.startswith("v ")])
    texture = np.array([[float(x) for x in line.split()[1:]] for line in lines if line.startswith("vt ")])
    faces = np.array([[int(c.split("/")[0]) - 1 for c in line.split()[1:]] for line in lines if line.startswith("f ")])
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert 0 <= texture.min() <= texture.max() <= 1
    picture_pattern(tmp_path / "a.png", SPACE, garment)
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "d.svg"
    assert main(["pattern", "--design", "dress", "--out", str(out), "--target-area", "1e-3"]) == 0
    said = capsys.readouterr().out
    assert "design   dress" in said
    assert "chest 0.980 m (0.88 to 1.18)" in said
    assert "hem 63.4 cm" in said
    assert f"wrote    {out}" in said
    assert out.exists()
    extra = ["--set", "hem_flare=0.1", "--parameters", "length", "hem_flare"]
    assert main(["pattern", "--target-area", "2e-3", *extra]) == 0
    assert "hem_flare 0.100 m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--design", "coat"], "unknown design 'coat'"),
        (["--sleeve-length", "0.9"], "sleeve_length = 0.9 m is outside its range 0 to 0.43 m"),
        (["--out", "a.pdf"], "unknown format of --out '.pdf'"),
        (["--picture", "a.gif"], "unknown format of --picture '.gif'"),
        (["--layout", "none.toml"], "no file at 'none.toml'"),
        (["--target-area", "0"], "target_area = 0 m^2"),
    ],
)
def test_bad_commands(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pattern", *arguments]) == 1
    assert message in capsys.readouterr().err
