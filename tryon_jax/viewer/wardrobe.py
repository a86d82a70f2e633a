"""What the page shows for given sliders, computed and timed; knows nothing of browsers."""

import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body import MeasurementFit, betas_from_measurements, shape_body
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.checks import check_choice
from tryon_jax.fit import Fit, measure_fit
from tryon_jax.garment import Design, GarmentMesh, build_template, remesh
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape_stages, prepare_mesh

LAYERS = ("drape", "smooth stage", "mesh on the mean body", "template on the mean body", "panels")
"""What can be shown of the garment, from the result back to the pattern."""

_KEPT = 16
_REACH = 2.5


@dataclass(frozen=True)
class Wish:
    """Where the sliders stand."""

    design: tuple[float, ...]
    """Metres, in the order of the design space."""
    betas: tuple[float, ...]
    fabric: str
    seed: int = 0


@dataclass(frozen=True)
class Surface:
    """A mesh to show."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


@dataclass
class Look:
    """The answer to a wish."""

    wish: Wish
    body: Surface
    layers: dict[str, Surface]
    """By the names of `LAYERS`."""
    mesh: GarmentMesh
    fit: Fit
    """Of the layer `drape`."""
    measured: dict[str, float]
    """The body's measurements, metres."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time of each stage."""


class Wardrobe:
    """Answers wishes with one model. Garments are padded to one size, so that a new design compiles nothing."""

    def __init__(self, model: TryOnModel) -> None:
        self.model = model
        self.space = config_space(model.config)
        largest = remesh(self.space, self.space.from_values(self.space.maximum), model.config.target_area)
        # Room for a few more vertices than the largest design has: another seed may need them.
        self._bucket = bucket_size(int(1.05 * largest.num_vertices))
        self._drape = jax.jit(drape_stages, static_argnames="fabric")
        self._template = jax.jit(apply_mean_drape)
        self._shape = jax.jit(lambda body, betas: shape_body(body, betas)[0])
        self._measure = jax.jit(measure_vertices)
        self._landmarks = load_landmarks(model.body)
        self._body_faces = np.asarray(model.body.faces)
        self._prepared: OrderedDict[tuple[tuple[float, ...], int], tuple[GarmentMesh, Garment]] = OrderedDict()
        # Pages share what is prepared, and one drape at a time is faster than two that fight for the processor.
        self._lock = threading.Lock()

    def start(self) -> Wish:
        """The wish that a page begins with."""
        design = tuple(float(v) for v in self.space.mean)
        return Wish(design, (0.0,) * self.model.config.num_betas, self.model.config.fabrics[0])

    def design(self, wish: Wish) -> Design:
        """The design of a wish; raises `ValueError` for values out of range."""
        return self.space.from_values(wish.design)

    def look(self, wish: Wish) -> Look:
        """Prepare what is new, drape, and measure the fit.

        Raises:
            ValueError: a design out of range, an unknown fabric, or a wrong number of betas.
        """
        check_choice("fabric", wish.fabric, self.model.config.fabrics)
        seconds: dict[str, float] = {}
        with self._lock:
            mesh, garment = self._prepare(wish, seconds)
            model, betas = self.model, np.asarray(wish.betas, np.float32)
            with _timed(seconds, "drape"):
                stages = jax.block_until_ready(self._drape(model, garment, betas, fabric=wish.fabric))
            with _timed(seconds, "body"):
                body = Surface(np.asarray(self._shape(model.body, betas)), self._body_faces)
                measured = {name: float(v) for name, v in self._measure(body.vertices, self._landmarks).items()}
            with _timed(seconds, "fit"):
                drape = garment.unpad(stages.fine)
                pattern = (mesh.faces, mesh.uv, mesh.faces_uv)
                fit = measure_fit(body.vertices, body.faces, self._landmarks, drape, *pattern)
            layers = {
                "drape": Surface(drape, mesh.faces),
                "smooth stage": Surface(garment.unpad(stages.smooth), mesh.faces),
                "mesh on the mean body": Surface(garment.unpad(stages.mean), mesh.faces),
                "template on the mean body": self._template_surface(wish),
                "panels": _panels(mesh),
            }
        return Look(wish, body, layers, mesh, fit, measured, seconds)

    def body_of(self, measurements: Mapping[str, float]) -> MeasurementFit:
        """The nearest body with these measurements, metres, among those that the networks know."""
        body = self.model.body
        few = replace(body, shapedirs=body.shapedirs[..., : self.model.config.num_betas])
        return betas_from_measurements(few, measurements, self._landmarks)

    def tape_ranges(self, names: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Least and greatest value of each measurement at the ends of what the networks were made for, metres."""
        ends = np.array(list(itertools.product((-_REACH, _REACH), repeat=self.model.config.num_betas)), np.float32)
        bodies = [np.asarray(self._shape(self.model.body, betas)) for betas in ends]
        measured = [self._measure(vertices, self._landmarks) for vertices in bodies]
        values = {name: [float(one[name]) for one in measured] for name in names}
        return {name: (min(some), max(some)) for name, some in values.items()}

    def _prepare(self, wish: Wish, seconds: dict[str, float]) -> tuple[GarmentMesh, Garment]:
        key = (wish.design, wish.seed)
        if key in self._prepared:
            self._prepared.move_to_end(key)
            return self._prepared[key]
        with _timed(seconds, "pattern and mesh"):
            mesh = remesh(self.space, self.design(wish), self.model.config.target_area, seed=wish.seed)
        with _timed(seconds, "graph"):
            self._prepared[key] = mesh, prepare_mesh(self.model, mesh, bucket=self._bucket)
        if len(self._prepared) > _KEPT:
            self._prepared.popitem(last=False)
        return self._prepared[key]

    def _template_surface(self, wish: Wish) -> Surface:
        sewn = build_template(self.space, self.design(wish), self.model.config.template_vertices)
        return Surface(np.asarray(self._template(self.model.mean, np.asarray(wish.design, np.float32))), sewn.faces)


def _panels(mesh: GarmentMesh) -> Surface:
    """The flat panels beside each other, upright before the floor."""
    shift = np.zeros(len(mesh.uv))
    left = 0.0
    for panel in range(len(mesh.panel_names)):
        own = mesh.uv_panels == panel
        shift[own] = left - mesh.uv[own, 0].min()
        left += np.ptp(mesh.uv[own, 0]) + 0.1
    shift -= (left - 0.1) / 2
    flat = np.stack([mesh.uv[:, 0] + shift, mesh.uv[:, 1] + 0.54, np.zeros(len(mesh.uv))], axis=1)
    return Surface(flat, mesh.faces_uv)


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
