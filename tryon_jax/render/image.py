"""Arrays to image files, and words on them."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from tryon_jax.files.atomic import atomic_path
from tryon_jax.render.colors import ColorScale

if TYPE_CHECKING:
    from PIL import Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
_INK = (70, 74, 80)


def check_picture_path(path: str | Path) -> Path:
    """Return `path`, or raise `ValueError` when its suffix is not an image's, `ImportError` when Pillow is missing."""
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise ValueError(f"cannot write picture {str(path)!r}: its suffix must be one of {', '.join(SUFFIXES)}")
    try:
        import PIL.Image  # noqa: F401
    except ImportError as error:
        raise ImportError("pictures need Pillow: pip install 'tryon_jax[pictures]'") from error
    return target


def to_image(picture: Float[np.ndarray, "H W 3"]) -> "Image.Image":
    """8-bit image of an sRGB picture in 0 to 1, with half a level of fixed noise against banding in soft gradients."""
    from PIL import Image

    levels = np.multiply(picture, 255, dtype=np.float32)
    levels += np.random.default_rng(0).random(picture.shape[:2], np.float32)[..., None]
    return Image.fromarray(np.clip(levels, 0, 255, out=levels).astype(np.uint8))


def save_image(path: str | Path, image: "Image.Image") -> None:
    """Write `image` in one step."""
    with atomic_path(check_picture_path(path)) as temporary:
        if temporary.suffix.lower() == ".png":
            image.save(temporary, compress_level=4)
        else:
            image.save(temporary, quality=93)


def write_words(image: "Image.Image", text: str, center: tuple[float, float], size: float) -> None:
    """Write one line of text, centred.

    Args:
        image: The picture, which is changed.
        text: One line.
        center: Its middle (column, row), pixels.
        size: Height of the letters, pixels.
    """
    from PIL import ImageDraw, ImageFont

    ImageDraw.Draw(image).text(center, text, fill=_INK, font=ImageFont.load_default(size), anchor="mm")


def scale_height(height: int) -> int:
    """Pixels that the colour bar and its words take at the lower edge of a picture of this height."""
    return int(66 * max(height / 900, 0.5))


def draw_scale(image: "Image.Image", scale: ColorScale) -> None:
    """Draw the colour bar with its label and three numbers in the middle of the lower edge."""
    from PIL import Image

    unit = max(image.height / 900, 0.5)
    width, height = int(320 * unit), int(12 * unit)
    left, top = (image.width - width) // 2, image.height - int(44 * unit)
    strip = scale.colors(np.linspace(scale.low, scale.high, width))
    bar = np.repeat(np.round(strip * 255).astype(np.uint8)[None], height, axis=0)
    image.paste(Image.fromarray(bar), (left, top))
    write_words(image, scale.label, (image.width / 2, top - 13 * unit), 16 * unit)
    for part in (0.0, 0.5, 1.0):
        number = f"{scale.low + part * (scale.high - scale.low):.3g}"
        write_words(image, number, (left + part * width, top + height + 12 * unit), 14 * unit)
