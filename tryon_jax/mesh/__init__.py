"""Host-side triangle mesh processing in NumPy: topology, repair, quality. Knows nothing of JAX, bodies or garments."""
