"""`drape` with displacement fields: networks once for a garment, one matrix product for all bodies."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._garments import garment_of, model_of
from benchmarks._reference import ReferenceGraph, double
from benchmarks._subjects import FRESH, Cell, Work, entries, generator, random_betas, rounding_mm, work_of_layers
from tryon_jax.nets import PAPER
from tryon_jax.nets.config import TryOnConfig
from tryon_jax.tryon import Garment, Stage, TryOnModel, drape, fine_of, load_pretrained


@cache
def fields_model(name: str) -> TryOnModel:
    """The pretrained model for "small", random weights for "paper"; without the corrections for single bodies, whose
    thresholds rounding may cross."""
    return replace(load_pretrained() if name == "small" else model_of(PAPER), skin=None)


class ReferenceFields:
    """Offset and fields of one garment in float64, from which drapes on any bodies are one product."""

    def __init__(self, model: TryOnModel, garment: Garment, fabric: str) -> None:
        config, graph = model.config, ReferenceGraph(garment)
        stages = [double(model.smooth), double(fine_of(model, fabric))]
        smoothed, vertices = graph.smooth(graph.vertices), graph.vertices
        detail, relative = vertices - smoothed, config.reference == "smoothed"
        parts = [vertices / config.position_scale, graph.skinning / config.weight_scale]
        parts += [_waves(vertices, config.wavelengths)] if config.wavelengths else []
        parts += [np.zeros((len(vertices), config.num_parameters))] * config.design_features
        both = [np.concatenate(some, axis=1) for some in (parts, parts + [detail / config.detail_scale])]
        self.mask, self._config, self._stages = graph.mask, config, stages
        self._offset = smoothed + detail if relative else vertices
        outputs = [graph.displacement(stage, x) for stage, x in zip(stages, both, strict=True)]
        fields = [output.reshape(len(vertices), 3, -1) for output in outputs]
        self._fields = [
            values if stage.fabric_values is None else values @ _mixing(config, np.asarray(stage.fabric_values))
            for stage, values in zip(stages, fields, strict=True)
        ]

    def drape(self, betas: np.ndarray) -> np.ndarray:
        """M_fine on one body, metres, padded."""
        config, betas = self._config, np.asarray(betas, np.float64)
        inputs = np.concatenate([betas / config.beta_scale, _waves(betas, config.beta_periods)])
        found = self._offset.copy()
        for stage, fields in zip(self._stages, self._fields, strict=True):
            found += fields @ _perceptron(stage, inputs)
        return found


def _mixing(config: TryOnConfig, values: np.ndarray) -> np.ndarray:
    """What makes fields of one fabric of those of all."""
    k, j = np.array(config.field_pairs).T
    mix = np.zeros((len(k), config.fields))
    mix[np.arange(len(k)), k] = values[j]
    return mix


def _perceptron(stage: Stage, inputs: np.ndarray) -> np.ndarray:
    assert stage.coefficients is not None
    weights, biases = stage.coefficients.weights, stage.coefficients.biases
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        inputs = inputs @ np.asarray(weight) + np.asarray(bias)
        inputs = np.tanh(inputs) if k + 1 < len(weights) else inputs
    return inputs


def _waves(values: np.ndarray, lengths: tuple[float, ...]) -> np.ndarray:
    phases = np.concatenate([values * (2 * np.pi / length) for length in lengths], axis=-1)
    return np.concatenate([np.sin(phases), np.cos(phases)], axis=-1)


@cache
def reference_fields(name: str, vertices: int) -> ReferenceFields:
    """Of the garment of this size, made once."""
    model = fields_model(name)
    return ReferenceFields(model, garment_of(model.config, vertices), model.config.fabrics[0])


def drape_with_fields(cell: Cell) -> Work:
    """From betas to vertices as users call it: networks, perceptron, sum of the fields."""
    model = fields_model(cell.config)
    config, fabric = model.config, model.config.fabrics[0]
    garment, rng = garment_of(config, cell.vertices), generator(cell)
    inputs = [(random_betas(cell, rng, config.num_betas),) for _ in range(FRESH)]

    def check(made: Callable[..., Any]) -> float:
        reference = reference_fields(cell.config, cell.vertices)
        found, worst = made(model, garment, *inputs[0]), 0.0
        for b in {0, cell.batch - 1}:
            exact = reference.drape(np.asarray(inputs[0][0][b]))[reference.mask]
            worst = max(worst, rounding_mm(np.asarray(found[b], np.float64)[reference.mask], exact))
        return worst

    nets, nodes = [model.smooth.net, fine_of(model, fabric).net], garment.graph.num_nodes
    flops, moved = work_of_layers(nets, nodes, 1, entries(garment), jnp.dtype(jnp.float32).itemsize)
    flops += 2.0 * len(nets) * cell.batch * nodes * 3 * config.fields
    moved += 12.0 * nodes * (cell.batch + len(nets) * config.fields)
    tolerance = 0.01 if cell.precision == "float32" else 0.1
    run: Callable[..., jax.Array] = partial(drape, fabric=fabric)
    return Work(run, (model, garment), inputs, check, tolerance, "mm", cell.batch, flops, moved)
