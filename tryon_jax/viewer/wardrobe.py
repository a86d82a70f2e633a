"""What the page shows for given sliders, computed and timed; knows nothing of browsers."""

import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body import MeasurementFit, betas_from_measurements, shape_body
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.checks import check_choice
from tryon_jax.contact.push_out import PushedOut, push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.garment import Design, GarmentMesh, build_template, placement, remesh
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.graph.build import closest_body_vertices
from tryon_jax.mesh.repair import LoadedGarment
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.physics.fabrics import known_fabric
from tryon_jax.training.protocol import EXTENT
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape_stages, prepare, prepare_mesh
from tryon_jax.types import Body
from tryon_jax.wear.fit import Fit, measure_fit, pattern_of
from tryon_jax.wear.other_body import OtherBody, meet
from tryon_jax.wear.posing import soft_skinning

LAYERS: tuple[str, ...] = (
    "drape",
    "fine stage",
    "smooth stage",
    "mesh on the mean body",
    "template on the mean body",
    "panels",
)
"""What can be shown of the garment, from the result back to the pattern; a mesh of one's own has no template."""

_KEPT = 16
_START = "dress"


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """A visitor's own garment, from a file."""

    name: str
    """The file's, for words and commands."""
    loaded: LoadedGarment


@dataclass(frozen=True)
class Wish:
    """Where the controls stand."""

    design: tuple[float, ...]
    """Metres, in the order of the design space."""
    betas: tuple[float, ...]
    """Of the body that is shown."""
    fabric: str
    seed: int = 0
    push_out: bool = True
    """Whether cloth inside the body is pushed out."""
    own: OwnMesh | None = None
    """A mesh in place of the design."""


@dataclass(frozen=True)
class Surface:
    """A mesh to show."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


@dataclass(frozen=True, eq=False)
class Cloth:
    """A garment that is ready to drape, with its pattern."""

    garment: Garment
    faces: Int[np.ndarray, "F 3"]
    uv: Float[np.ndarray, "U 2"]
    """Metres."""
    faces_uv: Int[np.ndarray, "F 3"]
    layers: dict[str, Surface]
    """Those that do not depend on the body."""
    mesh: GarmentMesh | None = None
    """What φ made of a design; None for a mesh of the visitor's own."""

    @property
    def design(self) -> Design | None:
        """Where there is one."""
        return None if self.mesh is None else self.mesh.design

    def start(self) -> Float[np.ndarray, "V 3"]:
        """Where a simulation begins, metres: flat panels round the body, or the visitor's mesh on the mean body."""
        return self.garment.mean_vertices if self.mesh is None else placement(self.mesh)


@dataclass(frozen=True)
class Look:
    """The answer to a wish. The fit is measured afterwards, by `Wardrobe.finish`."""

    wish: Wish
    body: Surface
    layers: dict[str, Surface]
    """By the names of `LAYERS`."""
    cloth: Cloth
    measured: dict[str, float]
    """The body's measurements, metres."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time of each stage."""
    fit: Fit | None = None
    """Of the layer `drape`."""
    pushed: PushedOut | None = None
    """What the push out of the body did, where it was wished."""


class Wardrobe:
    """Answers wishes with one model. Garments are padded to one size, so that a new design compiles nothing."""

    def __init__(self, model: TryOnModel, own_body: Body | None = None) -> None:
        """Get ready; with `own_body` that body is dressed in place of the networks' (see `wear.other_body`)."""
        self.model = model
        self.space = config_space(model.config)
        self.body = model.body if own_body is None else own_body
        self._other: OtherBody | None = None if own_body is None else meet(own_body, model.body, model.config.num_betas)
        count = model.config.num_betas if own_body is None else own_body.num_betas
        # What the networks were trained on; betas of another body are standard deviations too.
        self.beta_ranges = tuple(EXTENT[k] if own_body is None and k < len(EXTENT) else 2.0 for k in range(count))
        largest = remesh(self.space, self.space.from_values(self.space.maximum), model.config.target_area)
        # Room for a few more vertices than the largest design has: another seed may need them.
        self._bucket = bucket_size(int(1.05 * largest.num_vertices))
        self._drape = jax.jit(drape_stages, static_argnames="fabric")
        self._template = jax.jit(apply_mean_drape)
        self._shape = jax.jit(lambda body, betas: shape_body(body, betas)[0])
        self._measure = jax.jit(measure_vertices)
        self._landmarks = load_landmarks(self.body) if self._other is None else self._other.landmarks
        self._body_faces = np.asarray(self.body.faces)
        self._prepared: OrderedDict[object, Cloth] = OrderedDict()
        # Pages share what is prepared, and one drape at a time is faster than two that fight for the processor.
        self._lock = threading.Lock()

    @property
    def dresses_another_body(self) -> bool:
        """Whether the body is not the one that the networks know."""
        return self._other is not None

    def start(self) -> Wish:
        """The wish that a page begins with."""
        design = self.space.preset(_START) if _START in self.space.presets else self.space.mean_design
        values = tuple(float(v) for v in design.values)
        return Wish(values, (0.0,) * len(self.beta_ranges), self.model.config.fabrics[0])

    def look(self, wish: Wish) -> Look:
        """Prepare what is new, and drape.

        Raises:
            ValueError: a design out of range, an unknown fabric, a wrong number of betas, or a mesh that is no garment.
        """
        check_choice("fabric", wish.fabric, self.model.config.fabrics)
        seconds: dict[str, float] = {}
        model, own = self.model, np.asarray(wish.betas, np.float32)
        with self._lock:
            cloth = self._prepare(wish, seconds)
            with _timed(seconds, "body"):
                body = Surface(np.asarray(self._shape(self.body, own)), self._body_faces)
                measured = {name: float(v) for name, v in self._measure(body.vertices, self._landmarks).items()}
                betas = own if self._other is None else self._other.nearest_betas(body.vertices)
            with _timed(seconds, "drape"):
                stages = jax.block_until_ready(self._drape(model, cloth.garment, betas, fabric=wish.fabric))
                fine, smooth = (cloth.garment.unpad(stage) for stage in (stages.fine, stages.smooth))
        if self._other is not None:
            with _timed(seconds, "carry to your body"):
                nearest = closest_body_vertices(cloth.garment.mean_vertices, model.body)
                weights = soft_skinning(np.asarray(model.body.lbs_weights)[nearest], cloth.faces)
                fine, smooth = (self._other.carry(stage, weights, betas, own) for stage in (fine, smooth))
        layers = {
            "drape": Surface(fine, cloth.faces),
            "fine stage": Surface(fine, cloth.faces),
            "smooth stage": Surface(smooth, cloth.faces),
            **cloth.layers,
        }
        return Look(wish, body, layers, cloth, measured, seconds)

    def finish(self, look: Look) -> Look:
        """The look with its drape pushed out of the body, where that is wished, and with the fit."""
        if look.fit is not None:
            return look
        seconds, cloth, pushed = dict(look.seconds), look.cloth, None
        drape = look.layers["drape"].vertices
        if look.wish.push_out:
            with _timed(seconds, "push out"):
                pushed = push_out(drape, cloth.faces, ClosedSurface(look.body.vertices, look.body.faces))
            drape = pushed.vertices.astype(np.float32)
        with _timed(seconds, "fit"):
            pattern = (cloth.faces, cloth.uv, cloth.faces_uv)
            fabric = known_fabric(look.wish.fabric)
            fit = measure_fit(look.body.vertices, look.body.faces, self._landmarks, drape, *pattern, fabric)
        layers = look.layers | {"drape": Surface(drape, cloth.faces)}
        return replace(look, layers=layers, fit=fit, pushed=pushed, seconds=seconds)

    def body_of(self, measurements: Mapping[str, float]) -> MeasurementFit:
        """The nearest body with these measurements, metres, among those that the sliders can reach."""
        few = replace(self.body, shapedirs=self.body.shapedirs[..., : len(self.beta_ranges)])
        return betas_from_measurements(few, measurements, self._landmarks)

    def tape_ranges(self, names: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Least and greatest value of each measurement, metres, at the ends of the first two betas."""
        return {name: self._tapes[name] for name in names}

    @cached_property
    def _tapes(self) -> dict[str, tuple[float, float]]:
        ends = itertools.product(*((-reach, reach) for reach in self.beta_ranges[:2]))
        rest = (0.0,) * len(self.beta_ranges[2:])
        bodies = [np.asarray(self._shape(self.body, np.array([*end, *rest], np.float32))) for end in ends]
        measured = [self._measure(vertices, self._landmarks) for vertices in bodies]
        values = {name: [float(one[name]) for one in measured] for name in measured[0]}
        return {name: (min(some), max(some)) for name, some in values.items()}

    def _prepare(self, wish: Wish, seconds: dict[str, float]) -> Cloth:
        key = (wish.design, wish.seed) if wish.own is None else wish.own
        if key not in self._prepared:
            self._prepared[key] = self._cut(wish, seconds) if wish.own is None else self._take(wish.own, seconds)
            if len(self._prepared) > _KEPT:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(key)
        return self._prepared[key]

    def _cut(self, wish: Wish, seconds: dict[str, float]) -> Cloth:
        """The garment of a design."""
        design = self.space.from_values(wish.design)
        with _timed(seconds, "pattern and mesh"):
            mesh = remesh(self.space, design, self.model.config.target_area, seed=wish.seed)
        with _timed(seconds, "graph"):
            garment = prepare_mesh(self.model, mesh, bucket=self._bucket)
        sewn = build_template(self.space, design, self.model.config.template_vertices)
        template = np.asarray(self._template(self.model.mean, np.asarray(wish.design, np.float32)))
        layers = {
            "mesh on the mean body": Surface(garment.mean_vertices, mesh.faces),
            "template on the mean body": Surface(template, sewn.faces),
            "panels": _panels(mesh.uv, mesh.faces_uv, mesh.uv_panels),
        }
        return Cloth(garment, mesh.faces, mesh.uv, mesh.faces_uv, layers, mesh)

    def _take(self, own: OwnMesh, seconds: dict[str, float]) -> Cloth:
        """The garment of a visitor's mesh; a new size of mesh compiles the drape anew."""
        with _timed(seconds, "graph"):
            garment = prepare(self.model, mesh=own.loaded)
        mean, faces = garment.mean_vertices, garment.faces
        texture = own.loaded.texture()
        uv, faces_uv = pattern_of(mean, faces, *texture)
        layers = {"mesh on the mean body": Surface(mean, faces)}
        if uv is texture[0]:
            layers["panels"] = _panels(uv, faces_uv, np.zeros(len(uv), np.int32))
        return Cloth(garment, faces, uv, faces_uv, layers)


def _panels(uv: np.ndarray, faces_uv: np.ndarray, panel_of: np.ndarray) -> Surface:
    """The flat panels beside each other, upright before the floor."""
    shift = np.zeros(len(uv))
    left = 0.0
    for panel in np.unique(panel_of):
        mine = panel_of == panel
        shift[mine] = left - uv[mine, 0].min()
        left += np.ptp(uv[mine, 0]) + 0.1
    shift -= (left - 0.1) / 2
    flat = np.stack([uv[:, 0] + shift, uv[:, 1] - uv[:, 1].mean(), np.zeros(len(uv))], axis=1)
    return Surface(flat, faces_uv)


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
