"""Docstrings: a public function that takes more than two things says what each of them is."""

import ast
from collections.abc import Iterator
from pathlib import Path

import tryon_jax

LIBRARY = Path(tryon_jax.__file__).parent
SPECIAL = ("__init__", "__call__")


def public_functions(body: list[ast.stmt], owner: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions of a module and methods of its classes whose names have no underscore, by qualified name."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body, f"{owner}{node.name}.")
        elif isinstance(node, ast.FunctionDef) and (node.name in SPECIAL or not node.name.startswith("_")):
            yield owner + node.name, node


def parameters(function: ast.FunctionDef) -> list[str]:
    """Names of a function's parameters but for `self` and `cls`."""
    every = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [argument.arg for argument in every if argument.arg not in ("self", "cls")]


def lacking(path: Path) -> list[str]:
    """Public functions of a module with more than two parameters and no section `Args`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        f"{path.relative_to(LIBRARY).as_posix()}: {name}"
        for name, function in public_functions(tree.body)
        if len(parameters(function)) > 2 and "\nArgs:\n" not in (ast.get_docstring(function) or "")
    ]


def test_every_public_function_says_what_its_arguments_are():
    # Ruff (D417) checks that a section `Args` names every parameter.
    public = [path for path in LIBRARY.rglob("*.py") if not any(p.startswith("_") for p in path.parts[-2:])]
    assert len(public) > 100
    assert [name for path in sorted(public) for name in lacking(path)] == []


def test_a_function_without_arguments_described_is_found(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "LIBRARY", tmp_path)
    module = tmp_path / "made_up.py"
    module.write_text(
        '"""Made up."""\n\n\ndef two(a, b):\n    """Two."""\n\n\ndef three(a, b, c):\n    """Three."""\n\n\n'
        "class Thing:\n    def __init__(self, a, b, c):\n        pass\n\n"
        '    def told(self, a, b, c):\n        """Told.\n\n        Args:\n            a: one\n        """\n\n'
        "    def _private(self, a, b, c):\n        pass\n"
    )
    assert lacking(module) == ["made_up.py: three", "made_up.py: Thing.__init__"]
