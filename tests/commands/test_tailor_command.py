"""`tryon tailor` and `tryon size`: files, the answer in words, and what is refused."""

import json
from dataclasses import replace

import pytest

from tests.experiments.tiny_garments import tiny_model
from tryon_jax.cli import main
from tryon_jax.commands.tailor import describe
from tryon_jax.garment import load_design_space
from tryon_jax.tryon import save_model
from tryon_jax.wear.tailor import FitTarget, Tailored

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    model = tiny_model()
    save_model(path, replace(model, config=replace(model.config, target_area=1.2e-3)))
    return str(path)


def test_the_pattern_and_the_report_say_what_was_asked(weights, tmp_path, capsys):
    pattern, report, picture = (tmp_path / name for name in ("pattern.svg", "fit.json", "fit.png"))
    asked = ["--ease-chest", "0.12", "--hem", "0.7", "--design", "tshirt", "--rounds", "2"]
    files = ["--out", str(pattern), "--report", str(report), "--picture", str(picture), "--height", "80"]
    assert main(["tailor", "--weights", weights, *asked, *files, "--views", "front"]) == 0
    out = capsys.readouterr().out
    assert "ease at the chest 12.0 cm: predicted" in out
    assert "hem over the floor 70.0 cm" in out
    assert "<svg" in pattern.read_text()
    record = json.loads(report.read_text())
    assert record["asked"] == {"chest": 0.12, "hem": 0.7}
    assert record["design"]["sleeve_length"] == pytest.approx(0.15, abs=1e-3)
    assert picture.stat().st_size > 500


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "an ease at chest, waist or hip, or a height of the hem"),
        (["--hem", "60"], "height of the hem"),
        (["--hem", "0.7", "--out", "pattern.png"], "format of --out"),
        (["--hem", "0.7", "--design", "sock"], "sock"),
        (["--hem", "0.7", "--betas", "9"], "outside its range"),
    ],
)
def test_what_makes_no_sense_is_refused(weights, options, message, capsys):
    assert main(["tailor", "--weights", weights, *options]) == 1
    assert message in capsys.readouterr().err


def test_what_cannot_be_had_is_said():
    space = load_design_space()
    found = Tailored(FitTarget({"hip": 0.1}, 0.5), space.mean_design, None, {"hip": None, "hem": 0.56})
    lines = describe(found, {"length": "largest"})
    assert any("does not go round the body at the hip" in line for line in lines)
    assert any("hem is missed by +6.0 cm, with the largest length" in line for line in lines)


def test_sizes_are_compared(weights, tmp_path, capsys):
    table, picture = tmp_path / "sizes.csv", tmp_path / "sizes.png"
    table.write_text("name,design,garment_chest\nS,tshirt,0.95\nL,tshirt,1.1\n")
    assert main(["size", "--weights", weights, "--sizes", str(table), "--picture", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "size     S: ease" in out
    assert "size     L: ease" in out
    assert "answer" in out
    assert picture.stat().st_size > 500


def test_a_table_of_sizes_names_designs_alone(weights, tmp_path, capsys):
    table = tmp_path / "sizes.csv"
    table.write_text("name,design,chest\nS,tshirt,0.95\n")
    assert main(["size", "--weights", weights, "--sizes", str(table)]) == 1
    assert "column of sizes.csv" in capsys.readouterr().err
    table.write_text("name,garment_chest\nS,0.2\nM,9.0\n")
    assert main(["size", "--weights", weights, "--sizes", str(table)]) == 1
    error = capsys.readouterr().err
    assert "'S'" in error
    assert "'M'" in error
