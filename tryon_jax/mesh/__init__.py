"""Triangle meshes on the host, in NumPy: topology, repair, quality. Nothing here needs JAX, a body or a garment."""
