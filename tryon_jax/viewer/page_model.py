"""What the page shows for given controls, computed and timed, without a browser."""

import itertools
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import jax
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body.stance import LOWEST
from tryon_jax.garment import build_template
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.nets.mlp import apply_mean_drape
from tryon_jax.tryon import TryOnModel
from tryon_jax.types import Body
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.own import OwnGarment
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.session import Session
from tryon_jax.wear.stance import lower_arms
from tryon_jax.wear.stopwatch import Stopwatch

LAYERS: tuple[str, ...] = (
    "drape",
    "fine stage",
    "smooth stage",
    "mesh on the mean body",
    "template on the mean body",
    "panels",
)
"""What can be shown of the garment, from the result back to the pattern; a mesh of one's own has no template."""

_START = "dress"


@dataclass(frozen=True, eq=False)
class UploadedMesh:
    """A visitor's own garment, from a file."""

    name: str
    """The file's, for words and commands."""
    loaded: LoadedGarment | OwnGarment

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was found and changed, one sentence each."""
        return self.loaded.remarks if isinstance(self.loaded, OwnGarment) else self.loaded.repairs


@dataclass(frozen=True)
class Settings:
    """Where the controls stand."""

    design: tuple[float, ...]
    """Metres, in the order of the design space."""
    betas: tuple[float, ...]
    """Of the body that is shown."""
    fabric: str
    seed: int = 0
    push_out: bool = True
    """Whether cloth inside the body is pushed out."""
    own: UploadedMesh | None = None
    """A mesh in place of the design."""
    arms: float = 0.0
    """Degrees of the arms below the horizontal."""


@dataclass(frozen=True)
class ShownMesh:
    """A mesh to show."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres."""
    faces: Int[np.ndarray, "F 3"]


@dataclass(frozen=True)
class Result:
    """The answer to settings. The fit is measured afterwards, by `PageModel.finish`."""

    settings: Settings
    dressed: DressedBody
    layers: dict[str, ShownMesh]
    """By the names of `LAYERS`."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time of each stage."""
    standing: DressedBody | None = None
    """With the arms lowered, where they are; `dressed` is in T-pose."""

    @property
    def seen(self) -> DressedBody:
        """In the stance that was asked for."""
        return self.standing or self.dressed

    def body(self, layer: str) -> ShownMesh:
        """The body that is shown with a layer of the garment: all but the drape are in T-pose."""
        dressed = self.seen if layer == LAYERS[0] else self.dressed
        return ShownMesh(dressed.body.vertices, dressed.body.faces)


class PageModel:
    """Answers settings with one model. Garments are padded to one size, so that a new design compiles nothing."""

    def __init__(self, model: TryOnModel, own_body: Body | None = None) -> None:
        """Get ready; with `own_body` that body is dressed in place of the networks' (see `wear.other_body`)."""
        self.session = Session(model, body=own_body, one_size=True)
        count = self.session.num_betas
        # What the networks were trained on; betas of another body are standard deviations too.
        self.beta_ranges = model.config.beta_ranges if own_body is None else (2.0,) * count
        self._template = jax.jit(apply_mean_drape)
        self._fixed_layers: WeakKeyDictionary[PreparedGarment, dict[str, ShownMesh]] = WeakKeyDictionary()
        # Pages share what is prepared, and one drape at a time is faster than two that share the processor.
        self._lock = threading.Lock()

    @property
    def dresses_another_body(self) -> bool:
        """Whether the body is not the one that the networks know."""
        return self.session.other is not None

    @property
    def lowers_arms(self) -> bool:
        """Whether the networks know drapes of lowered arms on this body."""
        return self.session.model.stance is not None and not self.dresses_another_body

    def start(self) -> Settings:
        """The settings that a page begins with."""
        space = self.session.space
        design = space.preset(_START) if _START in space.presets else space.mean_design
        values = tuple(float(v) for v in design.values)
        arms = LOWEST if self.lowers_arms else 0.0
        return Settings(values, (0.0,) * len(self.beta_ranges), self.session.fabrics[0], arms=arms)

    def compute(self, settings: Settings, shown: Result | None = None) -> Result:
        """Prepare what is new, and drape.

        Args:
            settings: What to drape.
            shown: An earlier answer: of a design near to it the triangles are taken over, which is quicker. `finish`
                makes the garment anew.

        Raises:
            ValueError: A design out of range, an unknown fabric, too many betas, or a mesh that is no garment.
        """
        watch, session, own = Stopwatch(), self.session, settings.own
        with self._lock:
            if own is None:
                near = None if shown is None or shown.settings.own is not None else shown.dressed.garment
                garment = session.prepare(settings.design, seed=settings.seed, near=near, stopwatch=watch)
            else:
                garment = session.prepare(mesh=own.loaded, label=own.name, stopwatch=watch)
            dressed = session.drape(garment, settings.betas, fabric=settings.fabric, stopwatch=watch)
            standing = self._stand(dressed, settings, watch, outside=False)
        return Result(settings, dressed, self._layers(dressed, standing), watch.seconds, standing)

    def finish(self, result: Result) -> Result:
        """The result with its drape pushed out of the body, where that is asked for, with the fit and the verdict.

        A garment on the triangles of a near design is made anew first.
        """
        if result.dressed.garment.near is not None:
            result = self.compute(result.settings)
        dressed = result.dressed
        if dressed.fit is not None:
            return result
        watch = Stopwatch()
        if result.settings.push_out:
            dressed = self.session.push_out(dressed, stopwatch=watch)
        dressed = self.session.judge(dressed, stopwatch=watch)
        standing = self._stand(dressed, result.settings, watch, outside=result.settings.push_out)
        layers = result.layers | {"drape": ShownMesh((standing or dressed).vertices, dressed.faces)}
        seconds = result.seconds | watch.seconds
        return replace(result, dressed=dressed, layers=layers, seconds=seconds, standing=standing)

    def _stand(
        self, dressed: DressedBody, settings: Settings, watch: Stopwatch, *, outside: bool
    ) -> DressedBody | None:
        if not settings.arms:
            return None
        return lower_arms(self.session, dressed, settings.arms, simulate=False, outside=outside, stopwatch=watch)

    def tape_ranges(self, names: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Least and greatest value of each measurement, metres, at the ends of the first two betas."""
        return {name: self._tapes[name] for name in names}

    @cached_property
    def _tapes(self) -> dict[str, tuple[float, float]]:
        ends = itertools.product(*((-reach, reach) for reach in self.beta_ranges[:2]))
        measured = [self.session.shape(end).measurements for end in ends]
        values = {name: [one[name] for one in measured] for name in measured[0]}
        return {name: (min(some), max(some)) for name, some in values.items()}

    def _layers(self, dressed: DressedBody, standing: DressedBody | None) -> dict[str, ShownMesh]:
        garment = dressed.garment
        if garment not in self._fixed_layers:
            self._fixed_layers[garment] = self._layers_of(garment)
        return {
            "drape": ShownMesh((standing or dressed).vertices, dressed.faces),
            "fine stage": ShownMesh(dressed.fine, dressed.faces),
            "smooth stage": ShownMesh(dressed.smooth, dressed.faces),
            **self._fixed_layers[garment],
        }

    def _layers_of(self, garment: PreparedGarment) -> dict[str, ShownMesh]:
        """Those that do not depend on the body."""
        layers = {"mesh on the mean body": ShownMesh(garment.garment.mean_vertices, garment.faces)}
        if garment.design is not None:
            model = self.session.model
            sewn = build_template(self.session.space, garment.design, model.config.template_vertices)
            template = np.asarray(self._template(model.mean, np.asarray(garment.design.values, np.float32)))
            layers["template on the mean body"] = ShownMesh(template, sewn.faces)
        if garment.has_pattern:
            layers["panels"] = _panels(garment)
        return layers


def _panels(garment: PreparedGarment) -> ShownMesh:
    """The flat panels beside each other, upright before the floor."""
    uv = garment.uv
    panel_of = np.zeros(len(uv), np.int32) if garment.mesh is None else garment.mesh.uv_panels
    shift = np.zeros(len(uv))
    left = 0.0
    for panel in np.unique(panel_of):
        mine = panel_of == panel
        shift[mine] = left - uv[mine, 0].min()
        left += np.ptp(uv[mine, 0]) + 0.1
    shift -= (left - 0.1) / 2
    flat = np.stack([uv[:, 0] + shift, uv[:, 1] - uv[:, 1].mean(), np.zeros(len(uv))], axis=1)
    return ShownMesh(flat, garment.faces_uv)
