"""The unit of length of a file, found from the size of what it holds."""

UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Units of length that files come in, metres."""

PERSON = (1.0, 2.4)
"""Largest extent of a grown person in T-pose, metres: the ends are less than an inch's centimetres apart, so that one
number fits one unit only."""


def fitting_units(size: float, low: float, high: float) -> list[str]:
    """The units in which a length of `size` is within `low` to `high` metres, in the order of `UNITS`.

    Args:
        size: A length in the unknown unit.
        low: Smallest length that makes sense, metres.
        high: Largest length that makes sense, metres.
    """
    return [unit for unit, metres in UNITS.items() if low <= size * metres <= high]
