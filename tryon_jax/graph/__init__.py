"""Graphs of garments: Laplacian, quadric pooling hierarchy, size buckets and the one sparse product."""

from tryon_jax.graph.buckets import bucket_size, padding_share
from tryon_jax.graph.build import GarmentGraph, GraphLevel, build_graph, stack_graphs
from tryon_jax.graph.operator import SparseOperator, apply_operator, make_operator

__all__ = [
    "GarmentGraph",
    "GraphLevel",
    "SparseOperator",
    "apply_operator",
    "bucket_size",
    "build_graph",
    "make_operator",
    "padding_share",
    "stack_graphs",
]
