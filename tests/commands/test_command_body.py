"""`tryon body` from the outside."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tryon_jax.body import MEASUREMENTS
from tryon_jax.cli import main
from tryon_jax.commands._request import BodyShape


def test_writes_mesh_picture_and_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, picture, report = (tmp_path / name for name in ("body.glb", "body.png", "body.json"))
    files = ["--out", str(mesh), "--picture", str(picture), "--report", str(report), "--views", "front"]
    assert main(["body", "--betas", "1", "-0.5", *files, "--height", "200"]) == 0
    said = capsys.readouterr().out
    assert "stature        1.69" in said
    assert f"wrote    {picture}" in said
    loaded = trimesh.load_scene(mesh).to_geometry()
    assert len(loaded.faces) == 13544
    record = json.loads(report.read_text())
    assert record["betas"][:3] == [1.0, -0.5, 0.0]
    assert np.ptp(loaded.vertices[:, 1]) == pytest.approx(record["measurements"]["stature"], abs=1e-4)
    pixels = np.asarray(Image.open(picture).convert("RGB"), float)
    assert pixels.shape[0] == 200
    # A figure of skin in the middle of a grey room, as tall as most of the picture.
    skin = (pixels[..., 0] - pixels[..., 2]) > 25
    rows = np.flatnonzero(skin.any(axis=1))
    assert np.ptp(rows) > 140
    assert 0.05 < skin.mean() < 0.5


def test_finds_the_body_for_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["body", "--body", "male", "--stature", "1.80", "--waist", "0.9"]) == 0
    said = capsys.readouterr().out
    assert "from measurements" in said
    assert "(asked 1.800 m, off" in said
    assert "(asked 0.900 m, off" in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--stature", "172"], "172 looks like centimetres: give 1.72"),
        (["--betas", "nan"], "betas must be finite"),
        (["--betas", *["0"] * 11], "0 to 10 numbers"),
        (["--body", "mael"], "did you mean 'male'"),
        (["--smpl", "nowhere.npz"], "no file at"),
        (["--betas", "1", "--chest", "1"], "either betas or measurements"),
        (["--out", "body.stl"], ".stl"),
        (["--picture", "body.gif"], ".gif"),
    ],
)
def test_bad_requests_fail_in_one_line(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["body", *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_every_measurement_is_an_option() -> None:
    assert set(MEASUREMENTS) == {field.name for field in fields(BodyShape)} - {"betas"}
