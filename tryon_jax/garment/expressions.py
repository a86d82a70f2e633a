"""Arithmetic of layout files: numbers, + - * /, names and a few functions, and nothing else.

Layouts are data that people exchange, so expressions are walked as syntax trees and never handed to `eval`.
"""

import ast
import math
import operator
from collections.abc import Callable, Mapping

_BINARY: dict[type, Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _clamp(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


def _lerp(a: float, b: float, t: float) -> float:
    return a + (b - a) * t


def _ramp(x: float, start: float, end: float) -> float:
    return _clamp((x - start) / (end - start), 0.0, 1.0)


FUNCTIONS: dict[str, tuple[Callable[..., float], int | None]] = {
    "min": (min, None),
    "max": (max, None),
    "clamp": (_clamp, 3),
    "lerp": (_lerp, 3),
    "ramp": (_ramp, 3),
    "hypot": (math.hypot, 2),
    "sqrt": (math.sqrt, 1),
}
"""Functions that expressions may call, with their number of arguments (None: two or more)."""


def parse_expression(text: object, where: str) -> ast.expr:
    """Parse one expression and reject everything that is not arithmetic.

    Args:
        text: the expression, or a plain number.
        where: what error messages call it, for example "point 'hip'".

    Raises:
        ValueError: where the text is no expression, or uses anything but arithmetic.
    """
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise ValueError(f"{where}: an expression or a number is needed, not {text!r}")
    try:
        tree = ast.parse(str(text).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(f"{where}: cannot read the expression {text!r}") from error
    _check(tree, text, where)
    return tree


def _check(node: ast.expr, text: object, where: str) -> None:
    match node:
        case ast.Constant(value=value) if isinstance(value, (int, float)) and not isinstance(value, bool):
            return
        case ast.Name():
            return
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            parts = [left, right]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            parts = [operand]
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
            if name not in FUNCTIONS:
                raise ValueError(f"{where}: unknown function {name!r} in {text!r}; known: {', '.join(FUNCTIONS)}")
            count = FUNCTIONS[name][1]
            if len(parts) != count and (count is not None or len(parts) < 2):
                raise ValueError(f"{where}: {name} takes {count or 'two or more'} arguments, {len(parts)} in {text!r}")
        case _:
            raise ValueError(f"{where}: only arithmetic is allowed in {text!r}")
    for part in parts:
        _check(part, text, where)


def evaluate(node: ast.expr, names: Mapping[str, float], where: str) -> float:
    """Value of a parsed expression.

    Args:
        node: What `ast.parse` made of the expression.
        names: Values by name.
        where: Entry of the layout file, for messages.

    Raises:
        ValueError: for a name that is not (yet) defined, a division by zero, or a result that is not finite.
    """
    try:
        value = _evaluate(node, names)
    except KeyError as error:
        raise ValueError(f"{where}: {error.args[0]!r} is not defined before it is used") from None
    except (ZeroDivisionError, OverflowError, ValueError) as error:
        raise ValueError(f"{where}: {ast.unparse(node)} has no value ({error})") from None
    if not math.isfinite(value):
        raise ValueError(f"{where}: {ast.unparse(node)} is {value}")
    return value


def _evaluate(node: ast.expr, names: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=value):
            return float(value)  # pyright: ignore[reportArgumentType]
        case ast.Name(id=name):
            return names[name]
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_evaluate(left, names), _evaluate(right, names))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand, names)
        case ast.UnaryOp(operand=operand):
            return _evaluate(operand, names)
        case ast.Call(func=ast.Name(id=name), args=args):
            return float(FUNCTIONS[name][0](*(_evaluate(a, names) for a in args)))
    raise TypeError(f"unchecked expression node {node!r}")
