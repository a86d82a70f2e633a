"""The whole try-on as one object: from a design or a mesh, a body and a fabric to the garment, its fit and its files.

It keeps what need not be computed twice: the compiled drape, prepared garments, shaped bodies with their surfaces.
The command line and the viewer are built on it. Threads may share one.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.body import MeasurementFit, betas_from_measurements, check_betas, shape_body
from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import measure_vertices
from tryon_jax.checks import check_choice, check_file
from tryon_jax.contact.push_out import CLEARANCE, push_out
from tryon_jax.garment import Design, remesh
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.graph.build import closest_body_vertices
from tryon_jax.mesh.repair import LoadedGarment
from tryon_jax.physics.fabrics import fabric_names, known_fabric, load_fabric
from tryon_jax.tryon import TryOnModel, config_space, design_of, drape_stages, load_pretrained
from tryon_jax.types import ArrayLike, Body
from tryon_jax.wear.dressed import DressedBody, ShapedBody
from tryon_jax.wear.fit import measure_fit
from tryon_jax.wear.gate import Verdict, judge, judge_betas
from tryon_jax.wear.other_body import OtherBody, prepare_other_body
from tryon_jax.wear.own import OwnGarment, OwnOptions, bring_own
from tryon_jax.wear.posing import pose_dressed, soft_skinning
from tryon_jax.wear.prepared import PreparedGarment, prepared_design, prepared_own
from tryon_jax.wear.simulate import Progress, Simulator
from tryon_jax.wear.stopwatch import Stopwatch

Kept = TypeVar("Kept")
Betas = Float[ArrayLike, " b"] | Sequence[float]
"""At most `Session.num_betas` numbers, standard deviations; those left out are 0."""
DesignLike = Design | Mapping[str, float] | Sequence[float] | str | None
"""A design: parameters in metres by name or in order, the name of a preset, or None for the mean design."""

_GARMENTS, _SHAPES = 16, 8


class Session:
    """One model that dresses one body in any shape with any garment.

    Typical use::

        session = tj.Session()
        dressed = session.try_on("dress", betas=(1.5, -0.5), fabric="gray-interlock")
        print(*dressed.fit.lines(), sep="\\n")
        dressed.write("dress.glb")
    """

    def __init__(
        self,
        model: TryOnModel | None = None,
        *,
        body: Body | None = None,
        triangle_area: float | None = None,
        one_size: bool = False,
    ) -> None:
        """Get ready; nothing is compiled before it is needed.

        Args:
            model: Drapes what is asked for; by default the one that comes with the package.
            body: A body to dress in place of the networks' own one, such as an SMPL file: an approximation, see
                `wear.other_body`.
            triangle_area: Mean area of the triangles of garments that are cut from designs, square metres; by default
                what the networks were trained on.
            one_size: Pad the garments of all designs to the size of the largest, so that another design compiles
                nothing.

        Raises:
            ValueError: `body` is not closed, or lacks a joint or a landmark.
        """
        self.model = load_pretrained() if model is None else model
        self.space = config_space(self.model.config)
        self.other: OtherBody | None = (
            None if body is None else prepare_other_body(body, self.model.body, self.model.config.num_betas)
        )
        self.body = self.model.body if body is None else body
        self.triangle_area = self.model.config.target_area if triangle_area is None else triangle_area
        self._one_size = one_size
        self._drape = jax.jit(drape_stages, static_argnames="fabric")
        self._shape = jax.jit(lambda body, betas: shape_body(body, betas)[0])
        self._measure = jax.jit(measure_vertices)
        self._garments: OrderedDict[Hashable, PreparedGarment] = OrderedDict()
        self._shapes: OrderedDict[Hashable, ShapedBody] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def num_betas(self) -> int:
        """How many betas the body takes: those that the networks know, or all of another body."""
        return self.model.config.num_betas if self.other is None else self.body.num_betas

    @property
    def fabrics(self) -> tuple[str, ...]:
        """Names of the fabrics that the model knows; the first is the default."""
        return tuple(self.model.config.fabrics)

    @cached_property
    def landmarks(self) -> Landmarks:
        """Where tapes are laid on the body."""
        return load_landmarks(self.body) if self.other is None else self.other.landmarks

    def prepare(
        self,
        design: DesignLike = None,
        *,
        mesh: str | Path | LoadedGarment | OwnGarment | None = None,
        own: OwnOptions | None = None,
        label: str | None = None,
        seed: int = 0,
        stopwatch: Stopwatch | None = None,
        progress: Progress | None = None,
    ) -> PreparedGarment:
        """A garment ready to drape; the last ones are kept.

        Args:
            design: As in `tryon_jax.prepare`.
            mesh: In place of a design: a file with a mesh of the user's own, which is put on the mean body and settled
                there (see `bring`); or such a mesh as it hangs on the mean body, from `bring` or `mesh.load_garment`.
            own: What is known of the file.
            label: What to call a mesh; by default its file's name.
            seed: Another seed gives another mesh of the same design.
            stopwatch: Takes the time of "pattern and mesh" or "own mesh", and of "graph".
            progress: Told while a mesh settles.

        Raises:
            ValueError: Unknown parameters, values out of range, a design and a mesh at once, or a mesh that cannot be
                repaired, put on the body or settled there.
            FileNotFoundError: There is no such mesh file.
        """
        watch = stopwatch or Stopwatch()
        if mesh is not None:
            if design is not None:
                raise ValueError("prepare takes a design or a mesh, not both")
            return self._prepare_own(mesh, label, own or OwnOptions(), watch, progress)
        wanted = design_of(self.space, design)
        key = (str(wanted), tuple(float(v) for v in wanted.values), seed)

        def make() -> PreparedGarment:
            bucket = self._bucket if self._one_size else None
            with watch.stage("pattern and mesh"):
                cut = remesh(self.space, wanted, self.triangle_area, seed=seed)
            with watch.stage("graph"):
                return prepared_design(self.model, cut, bucket)

        return self._keep(self._garments, key, make, _GARMENTS)

    def _prepare_own(
        self,
        mesh: str | Path | LoadedGarment | OwnGarment,
        label: str | None,
        options: OwnOptions,
        watch: Stopwatch,
        progress: Progress | None,
    ) -> PreparedGarment:
        if isinstance(mesh, str | Path):
            path = check_file("garment", mesh)
            key: Hashable = (path, path.stat().st_mtime_ns, label, options)
        else:
            key = (id(mesh), label)

        def make() -> PreparedGarment:
            own = mesh
            if isinstance(own, str | Path):
                own = self.bring(own, options, label=label, stopwatch=watch, progress=progress)
            with watch.stage("graph"):
                return prepared_own(self.model, own, label or (own.name if isinstance(own, OwnGarment) else "mesh"))

        return self._keep(self._garments, key, make, _GARMENTS)

    def bring(
        self,
        mesh: str | Path,
        options: OwnOptions | None = None,
        *,
        label: str | None = None,
        stopwatch: Stopwatch | None = None,
        progress: Progress | None = None,
    ) -> OwnGarment:
        """A garment of the user's own from a file: put on the networks' mean body and settled there by simulation.

        Args:
            mesh: An OBJ, GLB, glTF or PLY file.
            options: What is known of it; unit, axes, origin, pose and pieces are found where they are not given.
            label: What to call it; by default its file's name.
            stopwatch: Takes the time of "own mesh".
            progress: Told while it settles.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It cannot be read or repaired, lies nowhere on the body, or does not settle.
        """
        with (stopwatch or Stopwatch()).stage("own mesh"):
            simulator = self._mean_simulator if options is None or options.settle else None
            return bring_own(mesh, self.model.body, options, simulator=simulator, progress=progress, name=label)

    @cached_property
    def simulator(self) -> Simulator:
        """The solver for the body that is dressed."""
        return Simulator(self.body)

    @cached_property
    def _mean_simulator(self) -> Simulator:
        """The solver for the networks' body."""
        return self.simulator if self.other is None else Simulator(self.model.body)

    @cached_property
    def _bucket(self) -> int:
        largest = remesh(self.space, self.space.from_values(self.space.maximum), self.triangle_area)
        # Room for a few more vertices than the largest design has: another seed may need them.
        return bucket_size(int(1.05 * largest.num_vertices))

    def shape(self, betas: Betas = (), *, stopwatch: Stopwatch | None = None) -> ShapedBody:
        """The body with these betas and its measurements; the last ones are kept.

        Args:
            betas: At most `num_betas` numbers, standard deviations; those left out are 0.
            stopwatch: Takes the time of "body".

        Raises:
            ValueError: Too many betas, or values that are not finite or too far out.
        """
        with (stopwatch or Stopwatch()).stage("body"):
            given = np.asarray(betas, np.float32).reshape(-1)
            if len(given) > self.num_betas:
                raise ValueError(f"betas has {len(given)} numbers, but this body takes at most {self.num_betas}")
            every = np.zeros(self.num_betas, np.float32)
            every[: len(given)] = given
            every = np.asarray(check_betas(self.body, every), np.float32)
            return self._keep(self._shapes, every.tobytes(), lambda: self._shaped(every), _SHAPES)

    def _shaped(self, betas: Float[np.ndarray, " b"]) -> ShapedBody:
        vertices = np.asarray(self._shape(self.body, betas))
        measured = {name: float(value) for name, value in self._measure(vertices, self.landmarks).items()}
        known = betas if self.other is None else self.other.nearest_betas(vertices)
        return ShapedBody(self.body, betas, known, vertices, measured)

    def body_of(self, measurements: Mapping[str, float]) -> MeasurementFit:
        """The nearest body with these measurements among the shapes that `num_betas` betas can take.

        Args:
            measurements: Metres by name, see `body.measurements.MEASUREMENTS`.

        Raises:
            ValueError: An unknown name, or a value out of range.
        """
        few = replace(self.body, shapedirs=self.body.shapedirs[..., : self.num_betas])
        return betas_from_measurements(few, measurements, self.landmarks)

    def drape(
        self,
        garment: PreparedGarment,
        betas: Betas = (),
        *,
        fabric: str | None = None,
        stopwatch: Stopwatch | None = None,
    ) -> DressedBody:
        """The garment as the networks drape it, neither pushed out of the body nor measured.

        Args:
            garment: From `prepare`.
            betas: As in `shape`.
            fabric: One of `fabrics`; the first by default.
            stopwatch: Takes the time of "body", "drape" and, for another body, "carry over".

        Raises:
            ValueError: An unknown fabric, or betas as in `shape`.
        """
        watch = stopwatch or Stopwatch()
        fabric = check_choice("fabric", fabric or self.fabrics[0], self.fabrics)
        body = self.shape(betas, stopwatch=watch)
        with watch.stage("drape"):
            stages = self._drape(self.model, garment.garment, body.known_betas, fabric=fabric)
            fine, smooth = (garment.garment.unpad(stage) for stage in (stages.fine, stages.smooth))
        if self.other is not None:
            with watch.stage("carry over"):
                weights = self._skinning(garment)
                fine, smooth = (
                    self.other.carry(stage, weights, body.known_betas, body.betas) for stage in (fine, smooth)
                )
        return DressedBody(body, garment, fabric, vertices=fine, smooth=smooth, fine=fine)

    def refine(
        self,
        dressed: DressedBody,
        steps: int | None = None,
        *,
        fabric: str | None = None,
        stopwatch: Stopwatch | None = None,
        progress: Progress | None = None,
    ) -> DressedBody:
        """The same brought to rest by the simulator: the folds of that fabric.

        Args:
            dressed: From `drape`.
            steps: Implicit steps at most; None to rest.
            fabric: Any fabric of `physics.fabrics`; by default the one that was draped.
            stopwatch: Takes the time of "simulation".
            progress: Told while it runs.

        Raises:
            ValueError: An unknown fabric, or steps outside 1 to 10,000.
            Diverged: The simulation left the numbers.
        """
        fabric = check_choice("fabric", fabric or dressed.fabric, fabric_names())
        with (stopwatch or Stopwatch()).stage("simulation"):
            result = self.simulator.refine(
                dressed.vertices, dressed.garment.pattern, load_fabric(fabric), dressed.body.betas, steps, progress
            )
        return replace(
            dressed, fabric=fabric, vertices=result.vertices, simulated=result, pushed=None, fit=None, verdict=None
        )

    def simulate(
        self,
        garment: PreparedGarment,
        betas: Betas = (),
        *,
        fabric: str | None = None,
        stopwatch: Stopwatch | None = None,
        progress: Progress | None = None,
    ) -> DressedBody:
        """The garment dressed by the simulator alone: from its panels, or from a mesh as it hangs on the mean body.

        Args:
            garment: From `prepare`.
            betas: As in `shape`.
            fabric: Any fabric of `physics.fabrics`; the model's first by default.
            stopwatch: Takes the time of "body" and "simulation".
            progress: Told while it runs.

        Raises:
            ValueError: An unknown fabric, or betas as in `shape`.
            Diverged: The simulation left the numbers.
        """
        watch = stopwatch or Stopwatch()
        fabric = check_choice("fabric", fabric or self.fabrics[0], fabric_names())
        body = self.shape(betas, stopwatch=watch)
        with watch.stage("simulation"):
            result = self.simulator.dress(garment.start(), garment.pattern, load_fabric(fabric), body.betas, progress)
        drape = result.vertices
        return DressedBody(body, garment, fabric, vertices=drape, smooth=drape, fine=drape, simulated=result)

    def judge(self, dressed: DressedBody, *, stopwatch: Stopwatch | None = None) -> DressedBody:
        """The same with the verdict of the gate (`wear.gate`); measured where it was not.

        `stopwatch` takes the time of "gate".
        """
        watch = stopwatch or Stopwatch()
        if dressed.fit is None:
            dressed = self.measure(dressed, stopwatch=watch)
        assert dressed.fit is not None
        garment = dressed.garment
        with watch.stage("gate"):
            verdict = judge(
                dressed.vertices,
                garment.faces,
                garment.uv,
                garment.faces_uv,
                self.body,
                dressed.body.vertices,
                mean=garment.garment.mean_vertices,
                pushed=dressed.pushed,
                clearance=dressed.fit.clearance,
            )
            far = self.judge_body(dressed.body)
        return replace(dressed, verdict=Verdict((*far.findings, *verdict.findings)))

    def judge_body(self, body: ShapedBody) -> Verdict:
        """Whether the networks know bodies of this shape."""
        return judge_betas(body.known_betas, self.model.config.beta_ranges)

    def push_out(
        self, dressed: DressedBody, clearance: float = CLEARANCE, *, stopwatch: Stopwatch | None = None
    ) -> DressedBody:
        """The same with the cloth outside the body, by the least displacement and checked by exact distances.

        Args:
            dressed: From `drape`.
            clearance: Distance to keep from the body, metres.
            stopwatch: Takes the time of "push out".

        Raises:
            ValueError: A clearance outside 0 to 5 cm.
        """
        with (stopwatch or Stopwatch()).stage("push out"):
            pushed = push_out(dressed.vertices, dressed.faces, dressed.body.surface, clearance)
        return replace(dressed, vertices=pushed.vertices.astype(np.float32), pushed=pushed, fit=None)

    def measure(self, dressed: DressedBody, *, stopwatch: Stopwatch | None = None) -> DressedBody:
        """The same with its fit; `stopwatch` takes the time of "fit"."""
        garment = dressed.garment
        with (stopwatch or Stopwatch()).stage("fit"):
            fit = measure_fit(
                dressed.body.surface,
                self.landmarks,
                dressed.vertices,
                garment.faces,
                garment.uv,
                garment.faces_uv,
                known_fabric(dressed.fabric),
            )
        return replace(dressed, fit=fit)

    def pose(
        self, dressed: DressedBody, pose: Float[ArrayLike, "J 3"], *, stopwatch: Stopwatch | None = None
    ) -> DressedBody:
        """The same body and garment in another pose, by skinning; the fit stays that of the T-pose.

        Args:
            dressed: From `drape`, `push_out` or `measure`.
            pose: Axis-angle vector of each joint relative to its parent, radians.
            stopwatch: Takes the time of "pose".

        Raises:
            ValueError: The session dresses another body than the networks', or a pose of another number of joints.
        """
        if self.other is not None:
            raise ValueError("poses are for the networks' body; another body stays in T-pose")
        with (stopwatch or Stopwatch()).stage("pose"):
            weights = self._skinning(dressed.garment)
            posed, garment = pose_dressed(
                self.model.body, dressed.body.vertices, dressed.vertices, weights, np.asarray(pose, np.float32)
            )
        return replace(dressed, body=replace(dressed.body, vertices=np.asarray(posed)), vertices=np.asarray(garment))

    def try_on(
        self,
        garment: PreparedGarment | DesignLike = None,
        betas: Betas = (),
        *,
        fabric: str | None = None,
        clearance: float | None = CLEARANCE,
        stopwatch: Stopwatch | None = None,
    ) -> DressedBody:
        """Prepare, drape, push out of the body, measure and judge, in one call.

        Args:
            garment: From `prepare`, or a design as there.
            betas: As in `shape`.
            fabric: One of `fabrics`; the first by default.
            clearance: Distance to keep from the body, metres; None to leave the drape as it is.
            stopwatch: Takes the time of each step.

        Raises:
            ValueError: As the steps do.
        """
        prepared = garment if isinstance(garment, PreparedGarment) else self.prepare(garment, stopwatch=stopwatch)
        dressed = self.drape(prepared, betas, fabric=fabric, stopwatch=stopwatch)
        if clearance is not None:
            dressed = self.push_out(dressed, clearance, stopwatch=stopwatch)
        return self.judge(dressed, stopwatch=stopwatch)

    def _skinning(self, garment: PreparedGarment) -> Float[np.ndarray, "V J"]:
        """Skinning weights of the garment on the networks' body."""
        nearest = closest_body_vertices(garment.garment.mean_vertices, self.model.body)
        return soft_skinning(np.asarray(self.model.body.lbs_weights)[nearest], garment.faces)

    def _keep(self, kept: "OrderedDict[Hashable, Kept]", key: Hashable, make: Callable[[], Kept], most: int) -> Kept:
        """What is kept under `key`, made where it is not there; of more than `most` the longest unused is dropped."""
        with self._lock:
            if key not in kept:
                kept[key] = make()
                if len(kept) > most:
                    kept.popitem(last=False)
            kept.move_to_end(key)
            return kept[key]
