"""Make the stored template of the built-in layout: python tools/bake_template.py

Trained networks depend on the connectivity it writes. Run it only when the layout's outlines change, and train anew.
"""

from pathlib import Path

from tryon_jax.garment.layout_file import load_layout
from tryon_jax.garment.template import TEMPLATE_VERTICES, make_reference, save_reference


def main() -> None:
    """Triangulate the mean design and write it beside the layout."""
    layout = load_layout("kimono")
    folder = Path(__file__).parents[1] / "tryon_jax" / "data" / "layouts"
    path = folder / f"{layout.name}_{TEMPLATE_VERTICES}.npz"
    save_reference(make_reference(layout, TEMPLATE_VERTICES), path)
    print(f"wrote {path} ({path.stat().st_size} bytes)")


if __name__ == "__main__":
    main()
