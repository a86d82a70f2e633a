import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.flat_model import flat_model
from tests.tryon.test_drape_fields import make_model
from tests.tryon.test_learned_stance import with_stance
from tryon_jax.body import load_body
from tryon_jax.cli import main
from tryon_jax.commands import _answer
from tryon_jax.commands._answer import PICTURE_ARMS, Treatment, pictured
from tryon_jax.commands._batch import Batch
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import resolve_betas
from tryon_jax.garment import load_design_space
from tryon_jax.tryon import model_file, save_model
from tryon_jax.wear.session import Session
from tryon_jax.wear.simulate import Simulated, Simulator


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    save_model(path, flat_model())
    return str(path)


# The flat panels cut through the body, which is far from what a push can mend.
COARSE = ["--triangle-area", "12", "--no-push-out", "--no-gate"]


def test_drape_writes_mesh_picture_and_report_and_tells_the_time(weights, tmp_path, capsys):
    mesh, picture, report = (tmp_path / name for name in ("dress.glb", "dress.png", "dress.json"))
    options = ["--design", "dress", "--betas", "1.5", "-0.5", "--height", "80", "--views", "front", *COARSE]
    files = ["--out", str(mesh), "--picture", str(picture), "--report", str(report)]
    assert main(["drape", "--weights", weights, *options, *files]) == 0
    out = capsys.readouterr().out
    for word in (
        "garment  dress",
        "chest ",
        "waist ",
        "hip ",
        "tension",
        "inside",
        "time ",
        "start-up",
        "drape",
        "picture",
    ):
        assert word in out
    scene = trimesh.load(mesh, process=False)
    assert set(scene.geometry) == {"body", "garment"}
    assert scene.geometry["garment"].visual.uv is not None
    record = json.loads(report.read_text())
    assert record["betas"] == [1.5, -0.5]
    assert record["fabric"] == "gray-interlock"
    assert record["design"]["length"] == pytest.approx(load_design_space().preset("dress")["length"])
    assert picture.stat().st_size > 1000


def test_morph_targets_are_written_with_their_error(weights, tmp_path, capsys):
    path = tmp_path / "dress.glb"
    command = ["drape", "--weights", weights, "--design", "dress", "--betas", "1.5", *COARSE, "--morph-targets"]
    assert main([*command, "--out", str(path)]) == 0
    assert "5 targets (beta1+, beta1-, beta2+, beta2-, beta1*beta2)" in capsys.readouterr().out
    # All networks are zero: the garment stays, and only the body moves.
    assert b'"betas_at_weight_1"' in path.read_bytes()
    for more, words in (
        (["--out", str(tmp_path / "a.obj")], "needs --out with a .glb file"),
        (["--out", str(path), "--simulate"], "leave out --simulate"),
        (["--out", str(path), "--parts", "body"], "leave out --parts body"),
    ):
        assert main([*command, *more]) == 1
        assert words in capsys.readouterr().err


def test_cloth_inside_the_body_is_pushed_out(weights, tmp_path, capsys):
    """A tube of cloth that dips a few millimetres into the hips."""
    body = load_body("female")
    vertices = np.asarray(body.v_template)
    belt = (np.abs(vertices[:, 1]) < 0.06) & (np.abs(vertices[:, 0]) < 0.25)
    faces = np.asarray(body.faces)[belt[np.asarray(body.faces)].all(axis=1)]
    path = tmp_path / "belt.ply"
    trimesh.Trimesh(vertices * [0.985, 1, 0.985], faces, process=False).export(path)
    command = ["drape", "--weights", weights, "--garment", str(path), "--out", str(tmp_path / "out.npz")]
    assert main([*command, "--no-push-out"]) == 0
    assert "pushed" not in capsys.readouterr().out
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "none does now" in out
    assert "inside   0.00 % of the vertices, 0.0 mm at most" in out


def test_design_parameters_replace_those_of_the_preset(weights, tmp_path):
    reports = []
    for changes in (
        ["--garment-length", "0.9", "--sleeve-length", "0.2"],
        ["--set", "length=0.9", "sleeve_length=0.2"],
    ):
        path = tmp_path / "report.json"
        command = ["drape", "--weights", weights, "--design", "tshirt", *changes, *COARSE, "--report", str(path)]
        assert main(command) == 0
        reports.append(json.loads(path.read_text()))
    assert reports[0]["design"] == reports[1]["design"]
    assert reports[0]["design"]["length"] == pytest.approx(0.9)


def test_measurements_in_place_of_betas(weights, tmp_path, capsys):
    path = tmp_path / "report.json"
    assert main(["drape", "--weights", weights, "--stature", "1.72", *COARSE, "--report", str(path)]) == 0
    assert "from measurements" in capsys.readouterr().out
    assert len(json.loads(path.read_text())["betas"]) == 2


def test_a_mesh_of_the_users_own_is_draped(weights, tmp_path, capsys, monkeypatch):
    """A drape that was written comes back as somebody's mesh, in centimetres."""
    # Flat panels pass through the body, and would be kept off its skin.
    monkeypatch.setattr(model_file, "keep_off_skin", lambda model: model)
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    assert main(["drape", "--weights", weights, "--design", "tshirt", *COARSE, "--out", str(first)]) == 0
    with np.load(first) as arrays:
        vertices, faces = arrays["garment_vertices"], arrays["garment_faces"]
    own = tmp_path / "own.ply"
    trimesh.Trimesh(100 * vertices, faces, process=False).export(own)
    capsys.readouterr()
    # Nor are they where a garment would be.
    as_it_is = ["--offset", "0", "0", "0", "--pose-of-garment", "t", "--unit", "cm", "--no-settle", "--no-gate"]
    command = ["drape", "--weights", weights, "--garment", str(own), "--no-push-out", *as_it_is]
    assert main([*command, "--out", str(second)]) == 0
    out = capsys.readouterr().out
    assert f"garment  own.ply; {len(vertices)} vertices, {len(faces)} triangles" in out
    assert "tension  0.0 %" in out, "the mesh as it came is unstretched"
    with np.load(second) as arrays:
        np.testing.assert_allclose(arrays["garment_vertices"], vertices, atol=1e-5)


def test_a_pose_turns_body_and_garment(weights, tmp_path):
    pose = np.zeros((24, 3))
    pose[0] = [0.0, np.pi / 2, 0.0]  # the whole body turns its front (+z) to +x
    np.savez(tmp_path / "pose.npz", pose=pose)
    straight, turned = tmp_path / "straight.npz", tmp_path / "turned.npz"
    command = ["drape", "--weights", weights, "--design", "tank", *COARSE]
    assert main([*command, "--out", str(straight)]) == 0
    assert main([*command, "--out", str(turned), "--pose", str(tmp_path / "pose.npz")]) == 0
    with np.load(straight) as before, np.load(turned) as after:
        for part in ("body", "garment"):
            x, y, z = before[f"{part}_vertices"].T
            np.testing.assert_allclose(after[f"{part}_vertices"], np.stack([z, y, -x], axis=1), atol=1e-5)


def test_arms_go_down_and_the_report_says_so(weights, tmp_path, capsys, monkeypatch):
    def lower(_, vertices, *_more):
        return Simulated(vertices, 0.005, 0.01, 60, np.zeros(len(vertices)))

    monkeypatch.setattr(Simulator, "lower_arms", lower)
    out = tmp_path / "standing.npz"
    command = ["drape", "--weights", weights, "--design", "tank", "--no-gate", "--no-push-out", *COARSE]
    assert main([*command, "--arms", "30", "--out", str(out), "--report", str(tmp_path / "fit.json")]) == 0
    assert "stance   arms 30 degrees below the horizontal" in capsys.readouterr().out
    assert json.loads((tmp_path / "fit.json").read_text())["arms"] == 30.0
    with np.load(out) as arrays:
        hands = np.abs(arrays["body_vertices"][:, 0]) > 0.6
        assert arrays["body_vertices"][hands, 1].max() < 0.3, "hands hang below the shoulders"
    for options, words in (
        (["--arms", "80"], "--arms = 80"),
        (["--arms", "10", "--pose", "pose.npz"], "either --arms or --pose"),
        (["--arms", "10", "--smpl", "body.npz"], "--arms is for the networks' body"),
    ):
        assert main([*command, *options]) == 1
        assert words in capsys.readouterr().err


def test_maps_colour_the_cloth(weights, tmp_path):
    path = tmp_path / "ease.glb"
    picture = tmp_path / "ease.png"
    options = ["--map", "ease", "--height", "80", "--views", "front", *COARSE]
    assert main(["drape", "--weights", weights, *options, "--out", str(path), "--picture", str(picture)]) == 0
    colors = trimesh.load(path, process=False).geometry["garment"].visual.vertex_attributes["color"]
    assert len(np.unique(colors, axis=0)) > 20


def test_a_batch_makes_one_mesh_per_row_and_a_table(weights, tmp_path, capsys):
    orders = tmp_path / "orders.csv"
    orders.write_text(
        "name,design,betas,stature,garment_length,fabric\n"
        "ann,dress,0.5 -1,,,camel-ponte-roma\n"
        "bea,tshirt,,1.70,,\n"
        ",tshirt,,,0.7,\n"
    )
    out = tmp_path / "results"
    command = ["drape", "--weights", weights, "--batch", str(orders), "--out", str(out), "--format", "npz", *COARSE]
    assert main(command) == 0
    assert sorted(path.name for path in out.iterdir()) == ["003.npz", "ann.npz", "bea.npz", "fit.csv"]
    text = (out / "fit.csv").read_text()
    with (out / "fit.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == ["ann", "bea", "003"]
    assert rows[0]["fabric"] == "camel-ponte-roma"
    assert rows[0]["betas"] == "0.5 -1"
    assert float(rows[2]["design_length"]) == pytest.approx(0.7)
    assert float(rows[0]["body_girth_hip"]) > 0.6
    with np.load(out / "ann.npz") as mesh:
        assert mesh["garment_uv"].shape[1] == 2
    # Again: nothing is done that is done; a row whose file is gone is done again.
    capsys.readouterr()
    (out / "bea.npz").unlink()
    assert main(command) == 0
    said = capsys.readouterr().out
    assert said.count("done before") == 2
    assert said.count("wrote ") == 2
    assert (out / "fit.csv").read_text() == text


@pytest.mark.slow
def test_rows_of_one_garment_are_draped_in_one_call_as_one_by_one(tmp_path, monkeypatch, capsys):
    """With networks that know the body; a row that fails among them fails alone."""
    path = tmp_path / "tiny.safetensors"
    save_model(path, make_model())
    bodies = {"a": "0.5 -1", "bad": "0.1 0.1", "b": "2 1", "c": "-1 0.3"}
    rows = [f"{name},tank,{betas}," for name, betas in bodies.items()]
    rows.insert(2, "other,tshirt,1 0,")
    rows.insert(3, "linen,tank,0 1,white-dots-on-blk")
    (tmp_path / "orders.csv").write_text("\n".join(["name,design,betas,fabric", *rows]))
    calls = []
    many = Session.drape_many

    def counted(self, garment, betas, **options):
        calls.append(len(betas))
        return many(self, garment, betas, **options)

    def resolve(body, shape, num_betas):
        if shape.betas == (0.1, 0.1):
            raise ValueError("no such body")
        return resolve_betas(body, shape, num_betas)

    command = ["drape", "--weights", str(path), *COARSE]
    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr(Session, "drape_many", counted)
        patched.setattr(Batch, "check", lambda *_: None)
        patched.setattr(_answer, "check", lambda *_: None)
        patched.setattr(_answer, "resolve_betas", resolve)
        options = ["--batch", str(tmp_path / "orders.csv"), "--out", str(out), "--format", "npz"]
        assert main([*command, *options]) == 1
    assert "1 of 6 rows failed: bad" in capsys.readouterr().err
    assert calls[0] == 3
    assert sorted(calls[1:]) == [1, 1]
    drapes = {}
    for name in ("a", "b", "c"):
        alone = tmp_path / f"{name}.npz"
        assert main([*command, "--design", "tank", "--betas", *bodies[name].split(), "--out", str(alone)]) == 0
        with np.load(alone) as one, np.load(out / f"{name}.npz") as row:
            drapes[name] = row["garment_vertices"]
            for part in ("garment_vertices", "body_vertices"):
                np.testing.assert_allclose(row[part], one[part], atol=1e-6)
    assert np.abs(drapes["a"] - drapes["b"]).max() > 1e-4


def test_a_batch_names_all_bad_rows_before_it_begins(weights, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = ["name,design,betas,fabric,garment", "a,dress,,,", "b,dres,,,", "c,,0 -4,,", "d,,,silk,", "e,,,,gone.obj"]
    (tmp_path / "orders.csv").write_text("\n".join(rows))
    assert main(["drape", "--weights", weights, "--batch", "orders.csv", "--out", "results"]) == 1
    err = capsys.readouterr().err
    assert "4 of 5 rows cannot be draped: row 2 (b): unknown design 'dres'" in err
    for word in ("row 3 (c)", "known from -2 to 2", "row 4 (d): unknown fabric 'silk'", "row 5 (e)", "gone.obj"):
        assert word in err
    assert not (tmp_path / "results").exists()


def test_a_batch_goes_on_after_a_row_that_fails(weights, tmp_path, capsys):
    """A mesh that is no garment is found out only when it is read; the columns are the same for every row."""
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    orders = tmp_path / "orders.csv"
    orders.write_text(f"name,design,garment\nown,,{tmp_path / 'bad.obj'}\ntop,tank,\nlong,maxi-dress,\n")
    command = ["drape", "--weights", weights, "--batch", str(orders), "--out", str(tmp_path / "out"), *COARSE]
    assert main(command) == 1
    said = capsys.readouterr()
    assert "failed   bad.obj" in said.out
    assert "1 of 3 rows failed: own; see fit.csv" in said.err
    with (tmp_path / "out" / "fit.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == ["own", "top", "long"]
    assert rows[0]["outcome"] == "failed"
    assert "bad.obj" in rows[0]["error"]
    assert all(rows[1][name] == "" for name in ("error", "too_tight"))
    assert (tmp_path / "out" / "long.glb").exists()


def test_a_torn_drape_is_refused_and_nothing_is_written(weights, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = [
        "--triangle-area",
        "12",
        "--design",
        "dress",
        "--out",
        "a.glb",
        "--picture",
        "a.png",
        "--report",
        "a.json",
    ]
    assert main(["drape", "--weights", weights, *options]) == 1
    err = capsys.readouterr().err
    assert "is refused: " in err
    assert "What to try: " in err
    assert list(tmp_path.iterdir()) == []
    assert main(["drape", "--weights", weights, *options, "--no-gate"]) == 0
    assert "refused " in capsys.readouterr().out
    assert json.loads((tmp_path / "a.json").read_text())["outcome"] == "refused"


def test_a_mesh_without_the_body(weights, tmp_path):
    path = tmp_path / "cloth.glb"
    assert main(["drape", "--weights", weights, "--parts", "garment", *COARSE, "--out", str(path)]) == 0
    assert set(trimesh.load(path, process=False).geometry) == {"garment"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--design", "dres"], "unknown design 'dres' (did you mean 'dress'?)"),
        (["--garment-length", "90"], "length = 90 m is outside its range"),
        (["--set", "hem=1"], "unknown parameter 'hem'"),
        (["--set", "length"], "--set takes NAME=VALUE"),
        (["--fabric", "silk"], "unknown fabric 'silk'"),
        (["--betas", "1", "--stature", "1.7"], "either betas or measurements"),
        (["--betas", "1", "2", "3"], "betas has 3 numbers, but only the first 2 are known"),
        (["--betas", "nan"], "betas must be finite"),
        (["--stature", "172"], "172 looks like centimetres"),
        (["--out", "dress.fbx"], "suffix '.fbx' is none of"),
        (["--picture", "dress.gif"], "suffix must be one of"),
        (["--triangle-area", "100"], "triangle area = 100 cm^2 is outside its range"),
        (["--batch", "missing.csv", "--out", "results"], "no file at 'missing.csv'"),
        (["--batch", "orders.csv"], "--batch needs --out"),
        (["--batch", "orders.csv", "--out", "r", "--design", "dress"], "columns of the CSV file"),
        (["--pose", "missing.npz"], "no file at 'missing.npz'"),
        (["--garment", "missing.obj"], "no file at 'missing.obj'"),
        (["--garment-length", "96"], "96 looks like centimetres: give 0.96"),
        (["--betas", "0", "-4"], "beta 2 = -4, known from -2 to 2"),
        (["--views", "frnt"], "unknown view 'frnt' (did you mean 'front'?)"),
        (["--height", "-5"], "picture height = -5 pixels is outside its range"),
        (["--map", "easy"], "unknown map 'easy' (did you mean 'ease'?); known: ease, tension, penetration"),
        (["--unit", "cm"], "give --garment"),
        (["--garment", "own.obj", "--seed", "2"], "--seed makes the mesh of a design"),
        (["--garment", "own.obj", "--triangle-area", "2"], "--triangle-area makes the mesh of a design"),
        (["--garment", "own.obj", "--unit", "yard"], "unknown unit 'yard'"),
        (["--refine", "0"], "--refine = 0 steps is outside its range"),
        (["--refine", "5", "6"], "--refine takes one number of steps or none"),
        (["--refine", "--simulate"], "either --refine or --simulate"),
        (["--out", "a.png", "--picture", "a.png"], "suffix '.png' is none of"),
        (["--report", "same.glb", "--out", "same.glb"], "each output needs a path of its own"),
        (["--garment", "missing.obj", "--design", "dress"], "either a design or --garment"),
    ],
)
def test_bad_requests_are_one_line_and_leave_nothing(weights, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own.obj"
    if "own.obj" in options:
        own.write_text("v 0 0 0\n")
    coarse = [] if {"--triangle-area", "--garment", "--betas"} & set(options) else COARSE
    assert main(["drape", "--weights", weights, *options, *coarse]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert message in err
    own.unlink(missing_ok=True)
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_cannot_be_written_are_refused_before_work(weights, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder.glb").mkdir()
    (tmp_path / "folder.png").mkdir()
    monkeypatch.setattr("tryon_jax.commands.drape._load", lambda _: pytest.fail("work was done"))
    for options, message in (
        (["--out", "file/x.glb"], "is a file and no folder"),
        (["--out", "folder.glb"], "is a directory"),
        (["--picture", "folder.png"], "is a directory"),
        (["--out", f"{'x' * 300}.glb"], "name too long"),
    ):
        assert main(["drape", "--weights", weights, *options]) == 1
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("design,color\ndress,red\n", "unknown column of orders.csv 'color'"),
        ("design,stature\ndress,tall\n", "row 1 of orders.csv: stature must be a number, got 'tall'"),
        ("name,design\na,dress\na,tshirt\n", "distinct names"),
        ("name,design\n../a,dress\n", "plain file name"),
        ("name,design\n", "distinct names"),
        ("design,stature\ndress,tall\n,1.7\na,b,c\n", "row 3 of orders.csv: it has more cells than the 2 columns"),
    ],
)
def test_bad_batch_files_name_the_row(weights, tmp_path, monkeypatch, capsys, text, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "orders.csv").write_text(text)
    assert main(["drape", "--weights", weights, "--batch", "orders.csv", "--out", "results"]) == 1
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["orders.csv"]


def test_pictures_show_learned_drapes_with_the_arms_down():
    session = Session(with_stance(flat_model()), triangle_area=2.5e-3)
    dressed = session.drape(session.prepare("tank"))
    plain = Treatment(push_out=False, gate=False)
    shown = pictured(session, dressed, plain, Clock())
    assert shown.arms == PICTURE_ARMS
    assert dressed.arms == 0.0
    for other, treatment, pose in (
        (dressed, replace(plain, arms=0.0), None),
        (dressed, plain, np.zeros((24, 3))),
        (
            replace(dressed, simulated=Simulated(dressed.vertices, 0.0, 0.01, 1, np.zeros(len(dressed.vertices)))),
            plain,
            None,
        ),
    ):
        assert pictured(session, other, treatment, Clock(), pose) is other
    # Panels round the body cut through it: what is refused with the arms down is shown in T-pose.
    assert pictured(session, dressed, replace(plain, gate=True), Clock()) is dressed
