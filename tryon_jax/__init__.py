"""Parametric virtual try-on in JAX: from a sewing pattern, a body shape and a fabric to the draped garment."""

__version__ = "0.1.0"
