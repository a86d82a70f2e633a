"""The whole try-on as one object: from a design or a mesh, a body and a fabric to the garment, its fit and its files.

It keeps what need not be computed twice: the compiled drape, prepared garments, shaped bodies with their surfaces.
The command line and the viewer are built on it. Threads may share one. Its bodies are in `session_bodies`, its garments
in `session_garments`; the steps from a garment to the dressed body are here.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice
from tryon_jax.contact.push_out import CLEARANCE, push_out
from tryon_jax.mesh.stretch_limit import limit_stretch
from tryon_jax.physics.fabric_numbers import host_fabric_numbers
from tryon_jax.physics.fabrics import fabric_names, is_fabric_file, known_fabric, load_fabric
from tryon_jax.tryon import DrapeFields, TryOnModel, drape_fields, drape_stages, field_stages, load_pretrained
from tryon_jax.types import ArrayLike, Body
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.fit import measure_fit
from tryon_jax.wear.gate import Verdict, judge
from tryon_jax.wear.last_used import LastUsed
from tryon_jax.wear.posing import pose_dressed
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.session_bodies import Betas
from tryon_jax.wear.session_garments import DesignLike, SessionGarments
from tryon_jax.wear.simulate import Progress
from tryon_jax.wear.standing import Standing
from tryon_jax.wear.stopwatch import Stopwatch

TOGETHER = 64
"""Bodies of one garment that are draped in one call; fewer are filled up to it, so that one program serves all."""
MOST_STRETCH = 1.35
"""Length of an edge over its rest length, of what is pushed out: where it is not tight all round, cloth is stretched
less, and single edges are the networks' errors. The gate warns from 1.4 on."""
_FIELDS = 16


class Session(SessionGarments):
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
        bodies_kept: int = 8,
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
            bodies_kept: Body shapes that are kept with their surfaces, the last ones asked for; 7 MB each.

        Raises:
            ValueError: `body` is not closed, or lacks a joint or a landmark.
        """
        super().__init__(load_pretrained() if model is None else model, body, bodies_kept, triangle_area, one_size)
        self._drape = jax.jit(drape_stages, static_argnames="fabric")
        self._make_fields = jax.jit(drape_fields, static_argnames="fabric")
        # A fabric by its numbers is an argument like any other: another one compiles nothing.
        self._make_any_fields = jax.jit(drape_fields)
        self._apply_fields = jax.jit(field_stages)
        self._fields: LastUsed[DrapeFields] = LastUsed(_FIELDS)
        self._standing = Standing(self.model)

    @property
    def fabrics(self) -> tuple[str, ...]:
        """Names of the fabrics that the networks drape; the first is the default.

        With an R_fine of all fabrics these are all that are embedded, and `drape` also takes the path of a fabric file.
        """
        known = self.model.config.known_fabrics
        return tuple(dict.fromkeys((*known, *fabric_names()))) if self._takes_any_fabric else known

    @property
    def _takes_any_fabric(self) -> bool:
        return bool(self.model.config.shared_fabrics)

    def drapes_fabric(self, fabric: str) -> bool:
        """Whether the networks drape a fabric of this name, or in this file; others are for the simulator."""
        return fabric in self.fabrics or (self._takes_any_fabric and is_fabric_file(fabric))

    def check_fabric(self, fabric: str | None) -> str:
        """Name of a fabric that the networks drape, or path of its file; the default one when None.

        Raises:
            ValueError: An unknown name, or a file that holds no fabric.
            FileNotFoundError: There is no such file.
        """
        name = fabric or self.fabrics[0]
        if self._takes_any_fabric and is_fabric_file(name):
            load_fabric(name)
            return name
        return check_choice("fabric", name, self.fabrics)

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
            fabric: One of `fabrics`, the first by default; with an R_fine of all fabrics, also the path of a file.
            stopwatch: Takes the time of "body", "drape" and, for another body, "carry over".

        Raises:
            ValueError: An unknown fabric, or betas as in `shape`.
        """
        return self.drape_many(garment, [betas], fabric=fabric, stopwatch=stopwatch)[0]

    def drape_many(
        self,
        garment: PreparedGarment,
        betas: Sequence[Betas],
        *,
        fabric: str | None = None,
        stopwatch: Stopwatch | None = None,
    ) -> list[DressedBody]:
        """`drape` on many bodies: the networks see the garment once.

        Args:
            garment: From `prepare`.
            betas: Of each body, as in `shape`.
            fabric: One of `fabrics`, the first by default; with an R_fine of all fabrics, also the path of a file.
            stopwatch: As in `drape`.

        Raises:
            ValueError: An unknown fabric, or betas as in `shape`.
        """
        watch = stopwatch or Stopwatch()
        fabric = self.check_fabric(fabric)
        bodies = [self.shape(one, stopwatch=watch) for one in betas]
        dressed = []
        for first in range(0, len(bodies), TOGETHER):
            some = bodies[first : first + TOGETHER]
            with watch.stage("drape"):
                smooth, fine = self._stages(garment, np.stack([body.known_betas for body in some]), fabric)
            if self.other is not None:
                with watch.stage("carry over"):
                    weights, pairs = self.skinning(garment), list(enumerate(some))
                    smooth, fine = (
                        [self.other.transfer(stage[k], weights, b.known_betas, b.betas) for k, b in pairs]
                        for stage in (smooth, fine)
                    )
            dressed += [
                DressedBody(body, garment, fabric, vertices=fine[k], smooth=smooth[k], fine=fine[k])
                for k, body in enumerate(some)
            ]
        return dressed

    def _stages(
        self, garment: PreparedGarment, betas: Float[np.ndarray, "B b"], fabric: str
    ) -> tuple[Float[np.ndarray, "B V 3"], Float[np.ndarray, "B V 3"]]:
        """M_smooth and M_fine on at most `TOGETHER` bodies."""
        count = len(betas)
        if count > 1:
            betas = np.concatenate([betas, np.broadcast_to(betas[:1], (TOGETHER - count, betas.shape[1]))])
        if self.model.config.conditioning == "fields":
            numbers = None if fabric in self.model.config.fabrics else host_fabric_numbers(load_fabric(fabric))

            def make() -> DrapeFields:
                if numbers is None:
                    return self._make_fields(self.model, garment.garment, fabric=fabric)
                return self._make_any_fields(self.model, garment.garment, fabric=numbers)

            key = (garment, fabric if numbers is None else numbers.tobytes())
            smooth, fine = self._apply_fields(self._fields.get(key, make), betas)
        else:
            stages = self._drape(self.model, garment.garment, betas, fabric=fabric)
            smooth, fine = stages.smooth, stages.fine
        return garment.garment.unpad(smooth)[:count], garment.garment.unpad(fine)[:count]

    def stand(self, dressed: DressedBody, degrees: float) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "B 3"]]:
        """The garment where R_stance has it with the arms lowered, and the body, metres; see `tj.lower_arms`.

        Args:
            dressed: In T-pose, on the networks' body.
            degrees: Of the arms below the horizontal.

        Raises:
            ValueError: The model has no R_stance.
        """
        return self._standing(dressed, degrees, self.skinning(dressed.garment))

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
            fabric: Any fabric of `physics.fabrics`, or the path of a file; by default the one that was draped.
            stopwatch: Takes the time of "simulation".
            progress: Told while it runs.

        Raises:
            ValueError: An unknown fabric, or steps outside 1 to 10,000.
            Diverged: The simulation diverged: positions or forces became infinite.
        """
        fabric = fabric or dressed.fabric
        cloth = load_fabric(fabric)
        with (stopwatch or Stopwatch()).stage("simulation"):
            result = self.simulator.refine(
                dressed.vertices, dressed.garment.pattern, cloth, dressed.body.betas, steps, progress
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
            fabric: Any fabric of `physics.fabrics`, or the path of a file; the model's first by default.
            stopwatch: Takes the time of "body" and "simulation".
            progress: Told while it runs.

        Raises:
            ValueError: An unknown fabric, or betas as in `shape`.
            Diverged: The simulation diverged: positions or forces became infinite.
        """
        watch = stopwatch or Stopwatch()
        fabric = fabric or self.fabrics[0]
        cloth = load_fabric(fabric)
        body = self.shape(betas, stopwatch=watch)
        with watch.stage("simulation"):
            result = self.simulator.dress(garment.start(), garment.pattern, cloth, body.betas, progress)
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
        with watch.stage("gate"):
            verdict = self.verdict(dressed, dressed.fit.clearance)
        return replace(dressed, verdict=verdict)

    def verdict(self, dressed: DressedBody, clearance: Float[np.ndarray, " V"]) -> Verdict:
        """What the gate says of a dressed body in any stance.

        Args:
            dressed: The dressed body.
            clearance: Distance of each vertex of the garment from the body, metres.
        """
        garment = dressed.garment
        found = judge(
            dressed.vertices,
            garment.faces,
            garment.uv,
            garment.faces_uv,
            self.body,
            dressed.body.vertices,
            mean=garment.garment.mean_vertices,
            pushed=dressed.pushed,
            clearance=clearance,
        )
        return Verdict((*self.judge_body(dressed.body).findings, *found.findings))

    def push_out(
        self, dressed: DressedBody, clearance: float = CLEARANCE, *, stopwatch: Stopwatch | None = None
    ) -> DressedBody:
        """The same with the cloth outside the body, by the least displacement and checked by exact distances.

        Edges of more than `MOST_STRETCH` times their rest length are pulled together before.

        Args:
            dressed: From `drape`.
            clearance: Distance to keep from the body, metres.
            stopwatch: Takes the time of "push out".

        Raises:
            ValueError: A clearance outside 0 to 5 cm.
        """
        with (stopwatch or Stopwatch()).stage("push out"):
            drape = np.asarray(dressed.vertices, np.float32)
            drape = limit_stretch(drape, *dressed.garment.rest_edges, MOST_STRETCH)
            pushed = push_out(drape, dressed.faces, dressed.body.surface, clearance)
        return replace(dressed, vertices=pushed.vertices, pushed=pushed, fit=None)

    def measure(self, dressed: DressedBody, *, stopwatch: Stopwatch | None = None) -> DressedBody:
        """The same with its fit; `stopwatch` takes the time of "fit"."""
        garment, pushed = dressed.garment, dressed.pushed
        # In another pose the distances are no longer those of this drape.
        clearance = pushed.distance if pushed is not None and pushed.vertices is dressed.vertices else None
        with (stopwatch or Stopwatch()).stage("fit"):
            fit = measure_fit(
                dressed.body.surface,
                self.landmarks,
                dressed.vertices,
                garment.faces,
                garment.uv,
                garment.faces_uv,
                known_fabric(dressed.fabric),
                body_girth=dressed.body.measurements or None,
                clearance=clearance,
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
            weights = self.skinning(dressed.garment)
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
            fabric: One of `fabrics`, the first by default; with an R_fine of all fabrics, also the path of a file.
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
