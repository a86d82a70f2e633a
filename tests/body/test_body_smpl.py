"""SMPL files of every kind, made here from the embedded body, and files that must be refused."""

import os
import pickle
import struct
import sys
import types
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import sparse

from tryon_jax.body import load_body, load_smpl, pose_body
from tryon_jax.body.unpickle import RefusedPickleError, read_arrays

BODY = load_body("female")
SHIFT = np.array([0.0, 0.2, -0.1])


def fields(**changes: Any) -> dict[str, Any]:
    tree = np.stack([np.array(BODY.parents), np.arange(24)]).astype(np.int64)
    tree[0, 0] = 2**32 - 1
    rng = np.random.default_rng(0)
    plain = {
        "v_template": np.asarray(BODY.v_template, np.float64) + SHIFT,
        "shapedirs": np.asarray(BODY.shapedirs, np.float64),
        "posedirs": 1e-3 * rng.normal(size=(6774, 3, 207)),
        "J_regressor": np.asarray(BODY.J_regressor, np.float64),
        "weights": np.asarray(BODY.lbs_weights, np.float64),
        "kintree_table": tree.astype(np.uint32),
        "f": np.asarray(BODY.faces).astype(np.uint32),
    }
    return plain | changes


def check_is_the_body(body: Any) -> None:
    np.testing.assert_allclose(body.v_template, BODY.v_template, atol=1e-6)
    np.testing.assert_allclose(body.shapedirs, BODY.shapedirs, atol=1e-8)
    np.testing.assert_allclose(body.J_regressor, BODY.J_regressor, atol=1e-7)
    np.testing.assert_array_equal(body.faces, BODY.faces)
    assert body.parents == BODY.parents
    assert body.joint_names == BODY.joint_names
    assert body.posedirs.shape == (207, 6774, 3)


def test_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "SMPL_FEMALE.npz", **fields(), unused=np.array([{"an": "object"}], object))
    body = load_smpl(tmp_path / "SMPL_FEMALE.npz")
    check_is_the_body(body)
    assert body.name == "SMPL_FEMALE"
    pose = jnp.zeros((24, 3)).at[4, 0].set(1.0)
    moved, _ = pose_body(body, jnp.zeros(10), pose)
    plain, _ = pose_body(BODY, jnp.zeros(10), pose)
    assert 1e-4 < float(jnp.abs(moved - plain).max()) < 0.05  # pose blend shapes are at work


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
@pytest.mark.parametrize("matrix", [sparse.csc_matrix, sparse.csr_array, sparse.coo_matrix, np.asarray])
def test_pickles_of_every_protocol_and_matrix(tmp_path: Path, protocol: int, matrix: Any) -> None:
    small = {"J_regressor": matrix(np.eye(3)[:2]), "f": np.arange(6, dtype=">u4").reshape(2, 3), "text": "lbs"}
    small |= {"fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)), "one": np.float32(1.5), "empty": np.zeros(0)}
    small |= {"objects": np.array([None, "a"], object), "nested": {"a": [1, 2.5, (True, None)]}}
    file = tmp_path / "small.pkl"
    file.write_bytes(pickle.dumps(small, protocol))
    read = read_arrays(file)
    dense = read["J_regressor"].toarray() if sparse.issparse(read["J_regressor"]) else read["J_regressor"]
    np.testing.assert_array_equal(dense, np.eye(3)[:2])
    np.testing.assert_array_equal(read["f"], small["f"])
    np.testing.assert_array_equal(read["fortran"], small["fortran"])
    assert (read["text"], read["one"], read["empty"].shape, read["nested"]) == ("lbs", 1.5, (0,), small["nested"])


def test_pickle_with_a_sparse_regressor(tmp_path: Path) -> None:
    file = tmp_path / "basic_model.pkl"
    file.write_bytes(pickle.dumps(fields(J_regressor=sparse.csc_matrix(np.asarray(BODY.J_regressor))), 2))
    check_is_the_body(load_smpl(file))


class Python2Pickle:
    """Writes the opcodes that Python 2 with old NumPy, SciPy and chumpy wrote; none of them need be installed."""

    def __init__(self) -> None:
        self.out = bytearray(b"\x80\x02")

    def text(self, text: str) -> None:
        self.out += b"U" + bytes([len(text)]) + text.encode()

    def value(self, value: Any) -> None:
        if isinstance(value, np.ndarray):
            self.array(value)
        elif callable(value):
            value()
        elif isinstance(value, str):
            self.text(value)
        elif value is None:
            self.out += b"N"
        elif isinstance(value, tuple):
            self.out += b"("
            for entry in value:
                self.value(entry)
            self.out += b"t"
        else:
            self.out += b"J" + struct.pack("<i", value)

    def array(self, array: np.ndarray) -> None:
        self.out += b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85U\x01btR(K\x01("
        for size in array.shape:
            self.out += b"J" + struct.pack("<i", size)
        self.out += b"tcnumpy\ndtype\n(U\x02" + array.dtype.str[1:].encode() + b"K\x00K\x01tR(K\x03U\x01<NNN"
        self.out += b"J\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89"
        self.out += b"T" + struct.pack("<i", array.nbytes) + array.tobytes() + b"tb"

    def object(self, module: str, name: str, state: dict[str, Any]) -> None:
        self.out += b"ccopy_reg\n_reconstructor\n(c" + f"{module}\n{name}\n".encode() + b"c__builtin__\nobject\nNtR"
        self.mapping(state)
        self.out += b"b"

    def mapping(self, state: dict[str, Any]) -> None:
        self.out += b"}("
        for key, value in state.items():
            self.text(key)
            self.value(value)
        self.out += b"u"


def test_chumpy_pickle_of_smpl_one(tmp_path: Path) -> None:
    plain = fields()
    writer = Python2Pickle()
    regressor = sparse.csc_matrix(plain["J_regressor"])
    parts = {"_shape": regressor.shape, "maxprint": 50, "indices": regressor.indices, "indptr": regressor.indptr}
    parts["data"] = regressor.data
    count = plain["shapedirs"].size
    more = np.concatenate([plain["shapedirs"].ravel(), np.zeros(5)])
    plain["J_regressor"] = lambda: writer.object("scipy.sparse.csc", "csc_matrix", parts)
    plain["v_template"] = (
        lambda array: lambda: writer.object("chumpy.ch", "Ch", {"x": array, "_parents": None, "_cache": None})
    )(plain["v_template"])
    inner = lambda: writer.object("chumpy.ch", "Ch", {"x": more})  # noqa: E731
    state = {"a": inner, "idxs": np.arange(count), "preferred_shape": (6774, 3, 10)}
    plain["shapedirs"] = lambda: writer.object("chumpy.reordering", "Select", state)
    writer.mapping(plain | {"bs_style": "lbs", "bs_type": "lrotmin"})
    file = tmp_path / "basicModel_f.pkl"
    file.write_bytes(bytes(writer.out) + b".")
    check_is_the_body(load_smpl(file))


@pytest.fixture
def chumpy(monkeypatch: pytest.MonkeyPatch) -> dict[str, type]:
    """Modules of chumpy's names, present while a test writes its file."""
    made: dict[str, type] = {}
    for module, name in (("chumpy.ch", "Ch"), ("chumpy.reordering", "Select")):
        made[name] = type(name, (), {"__module__": module, "__getstate__": lambda self: vars(self)})
        holder = types.ModuleType(module)
        setattr(holder, name, made[name])
        monkeypatch.setitem(sys.modules, module, holder)
    monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
    return made


@pytest.mark.parametrize("protocol", [0, 2, 3, 4, 5])
def test_chumpy_states_with_their_sets(tmp_path: Path, chumpy: dict[str, type], protocol: int) -> None:
    """`Ch.__new__` makes `_dirty_vars = set()`, and `__getstate__` drops `_parents` and `_cache` alone."""

    def made(kind: str, **state: Any) -> Any:
        one = chumpy[kind]()
        dependent = {"kept": {"deps": frozenset({"x"}), "value": None, "out_of_date": True}}
        common = {"_dirty_vars": {*state}, "_itr": None, "_make_dense": False, "_make_sparse": False}
        vars(one).update(common | {"_depends_on_deps": dependent} | state)
        return one

    plain = fields()
    directions = made("Ch", x=plain["shapedirs"].ravel())
    plain["shapedirs"] = made("Select", a=directions, idxs=np.arange(6774 * 30), preferred_shape=(6774, 3, 10))
    plain["v_template"] = made("Ch", x=plain["v_template"])
    file = tmp_path / "basicModel_f.pkl"
    file.write_bytes(pickle.dumps(plain, protocol))
    check_is_the_body(load_smpl(file))


@pytest.mark.parametrize("name", ["set", "frozenset"])
def test_sets_hold_plain_values_only(tmp_path: Path, name: str) -> None:
    file = tmp_path / "set.pkl"
    file.write_bytes(b"(dVchanged\nc__builtin__\n" + name.encode() + b"\n((lVx\naI3\naNatRs.")
    assert read_arrays(file)["changed"] == {"x", 3, None}
    file.write_bytes(b"(dVchanged\nc__builtin__\n" + name.encode() + b"\n((lc__builtin__\nobject\natRs.")
    with pytest.raises(RefusedPickleError, match=f"a {name} of other things than numbers and text"):
        read_arrays(file)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("dm", 0.1), ("in", 0.0254)])
def test_another_unit_is_told_by_the_size_of_a_person(tmp_path: Path, unit: str, metres: float) -> None:
    plain = fields()
    scaled = {name: plain[name] / metres for name in ("v_template", "shapedirs", "posedirs")}
    np.savez(tmp_path / "body.npz", **plain | scaled)
    with pytest.warns(UserWarning, match=f"took lengths as {unit} and brought them to metres"):
        body = load_smpl(tmp_path / "body.npz")
    check_is_the_body(body)
    np.testing.assert_allclose(body.posedirs, np.moveaxis(plain["posedirs"], 2, 0), atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_template": 1e6 * np.asarray(BODY.v_template)}, r"units across, which is no grown person \(1 to 2.4 m\)"),
        ({"v_template": 0.3 * np.asarray(BODY.v_template)}, "no grown person"),
        ({"v_template": 1e3 * np.asarray(BODY.v_template)}, "v_template is in mm, .* they are in another unit"),
    ],
)
def test_sizes_of_nobody_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    np.savez(tmp_path / "body.npz", **fields(**changes))
    with pytest.raises(ValueError, match=message):
        load_smpl(tmp_path / "body.npz")


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_arrays_of_objects_are_called_what_they_are(tmp_path: Path, suffix: str) -> None:
    """As `np.savez` writes a sparse matrix: one object in an array without axes."""
    held = np.empty((), object)
    held[()] = sparse.csc_matrix(np.asarray(BODY.J_regressor))
    file = tmp_path / f"body{suffix}"
    if suffix == ".npz":
        np.savez(file, **fields(J_regressor=held))
    else:
        file.write_bytes(pickle.dumps(fields(J_regressor=held), 2))
    with pytest.raises(ValueError, match="J_regressor holds Python objects and not numbers") as caught:
        load_smpl(file)
    assert "damaged" not in str(caught.value)


def test_more_joints_and_fewer_betas(tmp_path: Path) -> None:
    """SMPL-H has 52 joints and 16 betas, SMPL-X 55 and 400."""
    extra = 28
    regressor = np.concatenate([np.asarray(BODY.J_regressor), np.asarray(BODY.J_regressor)[[20] * extra]])
    weights = np.concatenate([np.asarray(BODY.lbs_weights), np.zeros((6774, extra))], axis=1)
    tree = np.stack([np.array([*BODY.parents, *[20] * extra]), np.arange(52)])
    directions = np.concatenate([np.asarray(BODY.shapedirs)] * 2, axis=2)[..., :16]
    wide = fields(J_regressor=regressor, weights=weights, kintree_table=tree, shapedirs=directions)
    del wide["posedirs"]
    np.savez(tmp_path / "model.npz", **wide)
    body = load_smpl(tmp_path / "model.npz", num_betas=4)
    assert (len(body.parents), body.num_betas, body.posedirs) == (52, 4, None)
    assert body.joint_names[21:24] == ("R_wrist", "joint_22", "joint_23")
    with pytest.raises(ValueError, match="num_betas = 17 is outside 1 to 16"):
        load_smpl(tmp_path / "model.npz", num_betas=17)


class Hostile:
    """Pickles as a call."""

    def __init__(self, call: Any, *arguments: Any) -> None:
        self.call, self.arguments = call, arguments

    def __reduce__(self) -> tuple:
        return self.call, self.arguments


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_hostile_pickles_are_refused_and_run_nothing(tmp_path: Path, protocol: int) -> None:
    mark = tmp_path / "was_here"
    calls = [
        Hostile(os.system, f"touch {mark}"),
        Hostile(exec, f"open({str(mark)!r}, 'w')"),
        Hostile(eval, f"open({str(mark)!r}, 'w')"),
        Hostile(getattr, "text", "join"),
        Hostile(np.load, str(mark)),
        Hostile(np.memmap, str(mark), "float32", "w+", 0, (4,)),
        Hostile(sparse.load_npz, str(mark)),
    ]
    for number, call in enumerate(calls):
        file = tmp_path / f"hostile{number}.pkl"
        file.write_bytes(pickle.dumps(fields(v_template=call), protocol))
        with pytest.raises(RefusedPickleError, match="nothing in it was run: it asks for"):
            load_smpl(file)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (b"cnumpy.core.multiarray\n_reconstruct\n(cos\nsystem\nt.", "asks for (os|posix|nt).system"),
        (b"\x80\x04\x8c\x05numpy\x8c\x0acore.dtype\x93.", r"asks for numpy.core.dtype"),
        (b"\x80\x04\x8c\x06chumpy\x8c\x0dch.os.systems\x93.", r"asks for chumpy.ch.os.system"),
        (b"c_codecs\nencode\n(Vx\nVzlib\ntR.", "encoding 'zlib'"),
        (b"cnumpy\ndtype\n(VV8\ntR.", "only plain numbers"),
        (b"cnumpy\ndtype\n(VO,O\ntR.", "only plain numbers"),
        (b"cnumpy.core.multiarray\nscalar\n(cnumpy\ndtype\n(VO8\ntRU\x0812345678tR.", "raw memory of objects"),
    ],
)
def test_crafted_opcodes_are_refused(tmp_path: Path, stream: bytes, message: str) -> None:
    file = tmp_path / "crafted.pkl"
    file.write_bytes(stream)
    with pytest.raises(RefusedPickleError, match=message):
        read_arrays(file)


def test_sparse_indices_out_of_range_are_refused(tmp_path: Path) -> None:
    matrix = sparse.csc_matrix(np.eye(3))
    matrix.indices[1] = 10**6
    file = tmp_path / "sparse.pkl"
    file.write_bytes(pickle.dumps({"J_regressor": matrix}))
    with pytest.raises(ValueError, match="damaged"):
        read_arrays(file)


def test_damaged_and_wrong_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"SMPL file: no file at .*gone.npz"):
        load_smpl(tmp_path / "gone.npz")
    with pytest.raises(IsADirectoryError, match="is a directory"):
        load_smpl(tmp_path)
    whole = tmp_path / "whole.npz"
    np.savez(whole, **fields())
    for suffix, content in (
        (".npz", whole.read_bytes()[: 10**6]),
        (".npz", b"not a zip"),
        (".npz", b""),
        (".pkl", pickle.dumps(fields(), 2)[: 10**6]),
        (".pkl", b"not a pickle"),
        (".pkl", b""),
    ):
        file = tmp_path / f"broken{suffix}"
        file.write_bytes(content)
        with pytest.raises(ValueError, match="truncated or damaged"):
            load_smpl(file)
    file = tmp_path / "list.pkl"
    file.write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(ValueError, match="one list and not a dictionary"):
        load_smpl(file)
    file = tmp_path / "body.obj"
    file.write_text("v 0 0 0")
    with pytest.raises(ValueError, match=r"must end in .npz or .pkl, not '.obj'"):
        load_smpl(file)
    file = tmp_path / "body"
    file.write_text("")
    with pytest.raises(ValueError, match=r"must end in .npz or .pkl, but it has no suffix"):
        load_smpl(file)
    np.savez(tmp_path / "other.npz", vertices=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="lacks v_template, shapedirs"):
        load_smpl(tmp_path / "other.npz")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"f": np.array([[0, 1, 6774]])}, "index 6774 vertices.*0 to 6774"),
        ({"f": np.array([[0, 1, -2]])}, "index 6774 vertices.*-2 to 1"),
        ({"v_template": np.full((6774, 3), np.nan)}, r"v_template must be finite.*\(0, 0\) is nan"),
        ({"v_template": np.zeros((6773, 3))}, r"shapedirs must be \(6773, 3\).*got \(6774, 3\)"),
        ({"v_template": np.zeros(3)}, r"v_template must have 2 axes, got shape \(3,\)"),
        ({"v_template": np.array([["a"] * 3] * 6774)}, "v_template must be numbers"),
        ({"weights": np.zeros((6774, 24))}, "row of weights must sum to 1"),
        ({"kintree_table": np.stack([np.arange(1, 25), np.arange(24)])}, "joint 1 has parent 2"),
        ({"posedirs": np.zeros((6774, 3, 9))}, r"posedirs must be \(6774, 3, 207\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    np.savez(tmp_path / "bad.npz", **fields(**changes))
    with pytest.raises(ValueError, match=message):
        load_smpl(tmp_path / "bad.npz")
