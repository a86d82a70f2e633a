"""The try-on in a browser: sliders for design, body and fabric, and the drape that follows them (extra `viewer`)."""

from tryon_jax.viewer.server import serve

__all__ = ["serve"]
