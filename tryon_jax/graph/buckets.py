"""Few sizes that every graph is padded to, so that a garment of a new topology runs without compiling."""

from collections.abc import Sequence

_STEPS = (8, 9, 10, 11, 12, 13, 14, 15)
_SMALLEST = 512


def bucket_size(num_nodes: int, multiple: int = 64) -> int:
    """The smallest bucket that holds `num_nodes`: 512 · 2^j · {1, 9/8, …, 15/8}; there is no largest one.

    Neighbouring buckets differ by 7 to 12.5 %, so less than that is padding. Every size is a multiple of `multiple`
    (a power of two up to 64), so that each of log2(multiple) halvings is exact.
    """
    if multiple not in (1, 2, 4, 8, 16, 32, 64):
        raise ValueError(f"multiple = {multiple} must be a power of two up to 64")
    scale = _SMALLEST // _STEPS[0]
    while True:
        for step in _STEPS:
            if step * scale >= num_nodes:
                return step * scale
        scale *= 2


def bucket_for_levels(level_sizes: Sequence[int]) -> int:
    """The smallest bucket whose halvings hold every level of a hierarchy, even one that could not be halved."""
    return bucket_size(max(size << level for level, size in enumerate(level_sizes)))


def padding_share(num_nodes: int) -> float:
    """The part of a bucket that is padding."""
    return 1.0 - num_nodes / bucket_size(num_nodes)
