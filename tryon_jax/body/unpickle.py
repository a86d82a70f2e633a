"""Read arrays out of a pickle without running anything that the pickle says.

A pickle is a program. Here it may use a few names only. None of them refers to NumPy, SciPy or chumpy: each is a
stand-in defined here that stores numbers and does nothing else. Any other name ends the reading with an error.
"""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

_PLAIN_KINDS = "biufSU"
_PLAIN_VALUES = (bool, int, float, str, bytes)
_SPARSE = {f"{kind}_{form}": kind for kind in ("csc", "csr", "coo") for form in ("matrix", "array")}


class RefusedPickleError(ValueError):
    """A pickle asks for something that is not an array."""


class _Dtype:
    """Takes down the type of an array."""

    def __init__(self, code: str = "", *_: Any) -> None:
        # Objects and records hold pointers, which must never be read from a file.
        try:
            self.type = None if code in ("O", "O8") else np.dtype(code)
        except TypeError as error:
            raise RefusedPickleError(f"it holds an array of unknown type {code!r}") from error
        if self.type is not None and self.type.kind not in _PLAIN_KINDS:
            raise RefusedPickleError(f"it holds an array of {code!r}; only plain numbers and text are admitted")

    def __setstate__(self, state: tuple) -> None:
        if self.type is not None and state[1] in ("<", ">"):
            self.type = self.type.newbyteorder(state[1])

    def read(self, data: Any, shape: tuple, order: Any) -> np.ndarray:
        """An array of this type from raw bytes, which Python 2 wrote as text."""
        if self.type is None:
            raise RefusedPickleError("it holds raw memory of objects; only plain numbers and text are admitted")
        raw = data.encode("latin1") if isinstance(data, str) else bytes(data)
        return np.frombuffer(raw, self.type).reshape(shape, order=order)


class _Array:
    """Takes down a NumPy array."""

    value: Any = None

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        if isinstance(data, list):
            # An array of objects comes as a list. It stays one of stand-ins, so that it can be told from numbers.
            self.value = np.empty(len(data), object)
            self.value[:] = data
            self.value = self.value.reshape(shape)
        else:
            self.value = dtype.read(data, shape, "F" if fortran else "C")

    def settle(self) -> Any:
        """The array."""
        return self.value


class _Held:
    """Takes down the attributes of an object."""

    state: ClassVar[dict] = {}

    def __init__(self, *_: Any) -> None: ...

    def __setstate__(self, state: Any) -> None:
        vars(self)["state"] = state[0] if isinstance(state, tuple) else state


class _Sparse(_Held):
    """Takes down a sparse matrix of SciPy."""

    kind: ClassVar[str] = ""

    def settle(self) -> Any:
        """The matrix; its indices are checked, because SciPy's compiled code trusts them."""
        parts = {key: _settle(entry) for key, entry in self.state.items()}
        shape = parts.get("_shape", parts.get("shape"))
        if self.kind == "coo":
            place = (parts["row"], parts["col"]) if "row" in parts else tuple(_settle(axis) for axis in parts["coords"])
            return sparse.coo_array((parts["data"], place), shape=shape)
        build = sparse.csc_array if self.kind == "csc" else sparse.csr_array
        matrix = build((parts["data"], parts["indices"], parts["indptr"]), shape=shape)
        matrix.check_format(full_check=True)
        return matrix


class _Chumpy(_Held):
    """Stores an array of chumpy, or a selection of its entries."""

    def settle(self) -> Any:
        """The array."""
        if "idxs" in self.state:
            chosen = np.ravel(_settle(self.state["a"]))[np.ravel(_settle(self.state["idxs"]))]
            return chosen.reshape(self.state.get("preferred_shape", chosen.shape))
        if "x" in self.state:
            return _settle(self.state["x"])
        raise RefusedPickleError(f"it holds a chumpy expression of {sorted(self.state)} instead of an array")


def _settle(value: Any) -> Any:
    return value.settle() if isinstance(value, _Array | _Sparse | _Chumpy) else value


def _encode(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise RefusedPickleError(f"it wants text in the encoding {encoding!r}; only latin1 is admitted")
    return text.encode("latin1")


def _plain_set(kind: type, *items: Any) -> set | frozenset:
    """A set of plain values, as chumpy keeps the names of what has changed."""
    members = list(items[0]) if items else []
    if len(items) > 1 or not all(value is None or isinstance(value, _PLAIN_VALUES) for value in members):
        raise RefusedPickleError(f"it holds a {kind.__name__} of other things than numbers and text")
    return kind(members)


def _from_buffer(data: Any, dtype: _Dtype, shape: tuple, order: Any) -> np.ndarray:
    return dtype.read(data, shape, order)


class _ArrayUnpickler(pickle.Unpickler):
    """Python's reader with a fixed set of names."""

    def __init__(self, stream: Any) -> None:
        super().__init__(stream, encoding="latin1")
        # A pickle may set attributes of whatever it names, so each file gets names of its own.
        self.names: dict[str, Callable] = {
            "dtype": type("Dtype", (_Dtype,), {}),
            "ndarray": type("Array", (_Array,), {}),
            "_reconstruct": lambda kind, *_: kind(),
            "_reconstructor": lambda kind, *_: kind(),
            "scalar": lambda dtype, data: dtype.read(data, (1,), "C")[0],
            "_frombuffer": lambda *parts: _from_buffer(*parts),
            "encode": lambda text, encoding: _encode(text, encoding),
            "bytes": lambda: b"",
            "object": type("Nothing", (), {}),
            "set": lambda *items: _plain_set(set, *items),
            "frozenset": lambda *items: _plain_set(frozenset, *items),
            "chumpy": type("Chumpy", (_Chumpy,), {}),
            **{name: type(name, (_Sparse,), {"kind": kind}) for name, kind in _SPARSE.items()},
        }

    def find_class(self, module: str, name: str) -> Callable:
        """The stand-in for `module.name`; raises `RefusedPickleError` for anything that is not an array."""
        root, _, rest = module.partition(".")
        numpy_core = root == "numpy" and rest.startswith(("core.", "_core."))
        if (
            (module == "numpy" and name in ("dtype", "ndarray"))
            or (numpy_core and name in ("_reconstruct", "scalar", "_frombuffer"))
            or (module == "_codecs" and name == "encode")
            or (module in ("copy_reg", "copyreg") and name == "_reconstructor")
            or (module in ("__builtin__", "builtins") and name in ("object", "bytes", "set", "frozenset"))
            or (module.startswith("scipy.sparse") and name in _SPARSE)
        ):
            return self.names[name]
        if root == "chumpy" and name.isidentifier():
            return self.names["chumpy"]
        raise RefusedPickleError(f"it asks for {module}.{name}, which is not an array of NumPy, SciPy or chumpy")


_DAMAGE = (
    *(pickle.UnpicklingError, EOFError, AttributeError, LookupError, TypeError, ValueError),
    *(ArithmeticError, MemoryError, RecursionError),
)


def read_arrays(path: str | Path) -> dict[str, Any]:
    """The dictionary in the pickle at `path`, its arrays as NumPy arrays and its sparse matrices as SciPy's.

    Nothing that the pickle names is imported or run. Raises `RefusedPickleError` (a `ValueError`) when it names
    anything but arrays, and `ValueError` when it is truncated, damaged, or not a dictionary.
    """
    try:
        with open(path, "rb") as stream:
            content = _ArrayUnpickler(stream).load()
        arrays = {str(key): _settle(value) for key, value in content.items()} if isinstance(content, dict) else None
    except RefusedPickleError as error:
        raise RefusedPickleError(f"{str(path)!r} is refused and nothing in it was run: {error}") from error
    except _DAMAGE as error:
        raise ValueError(f"{str(path)!r} is not a readable pickle (truncated or damaged): {error}") from error
    if arrays is None:
        raise ValueError(f"{str(path)!r} holds one {type(content).__name__} and not a dictionary of arrays")
    return arrays
