"""Carry out requests: prepare garments, drape them, measure the fit. Shared by the commands that drape."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from tryon_jax.body import shape_body
from tryon_jax.body.landmarks import Landmarks, load_landmarks
from tryon_jax.body.measurements import check_measurement
from tryon_jax.checks import check_choice, check_file, check_range
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import Cut, Request, resolve_betas, resolve_design
from tryon_jax.contact.push_out import PushedOut, push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.garment import Design, placement, remesh
from tryon_jax.graph.build import closest_body_vertices
from tryon_jax.physics.fabrics import fabric_names, known_fabric, load_fabric
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape, prepare, prepare_mesh
from tryon_jax.wear.fit import Fit, measure_fit
from tryon_jax.wear.gate import Verdict, judge, judge_betas, known_range
from tryon_jax.wear.other_body import OtherBody
from tryon_jax.wear.own import OwnOptions, bring_own
from tryon_jax.wear.posing import pose_dressed, soft_skinning
from tryon_jax.wear.simulate import Pattern, Simulated, Simulator


@dataclass(frozen=True)
class Prepared:
    """A garment that is ready to drape, with its pattern."""

    garment: Garment
    faces: Int[np.ndarray, "F 3"]
    uv: Float[np.ndarray, "U 2"]
    """Metres."""
    faces_uv: Int[np.ndarray, "F 3"]
    label: str
    """What it is, in words."""
    remarks: tuple[str, ...] = ()
    design: Design | None = None
    """None for a mesh of the user's own."""
    panels: Float[np.ndarray, "V 3"] | None = None
    """Where dressing begins, metres: flat panels round the body, or a mesh of the user's own as it hangs."""

    @property
    def pattern(self) -> Pattern:
        """Mesh and rest shape."""
        return Pattern(self.faces, self.uv, self.faces_uv)


@dataclass(frozen=True)
class Treatment:
    """What is done to a drape besides draping it, and whether it must pass the gate."""

    clearance: float | None = None
    """Metres to push cloth out of the body to; None leaves it where it is."""
    refine: int | None = None
    """Steps of the simulator after the networks; 0 to rest; None for none."""
    simulate: bool = False
    """Dress by the simulator alone, without the networks."""
    gate: bool = True
    """Refuse what is torn or lies in the body."""


@dataclass(frozen=True)
class Draped:
    """A garment on a body, with what is said about it."""

    body: tuple[np.ndarray, np.ndarray]
    """Vertices, metres, and faces."""
    vertices: Float[np.ndarray, "V 3"]
    """The garment's, metres."""
    prepared: Prepared
    betas: Float[np.ndarray, " b"]
    fit: Fit
    fabric: str
    lines: list[str]
    """The report in words."""
    verdict: Verdict = field(default_factory=Verdict)
    """What the gate says."""

    def record(self, request: Request) -> dict[str, Any]:
        """Everything of the report, for JSON and CSV."""
        design = self.prepared.design
        return {
            "name": request.name,
            "garment": self.prepared.label,
            "design": {} if design is None else design.as_dict(),
            "betas": [float(b) for b in self.betas],
            "fabric": self.fabric,
            "vertices": len(self.vertices),
            "outcome": self.verdict.outcome,
            "findings": [finding.text for finding in self.verdict.findings],
            **self.fit.as_dict(),
        }


class Studio:
    """A model with the garments that it has prepared; one compiled drape serves all of one size.

    `treatment` says what is done to a drape besides, `own` how meshes of the user's own are taken in. With an
    `other_body` requests are for that one, whose betas they give, and drapes are carried over to it. `triangle_area` is
    the mean area of the cloth's triangles in square centimetres, None for what the networks were trained on; another
    `seed` gives other meshes of the same garments.
    """

    def __init__(
        self,
        model: TryOnModel,
        clock: Clock,
        *,
        treatment: Treatment | None = None,
        own: OwnOptions | None = None,
        other_body: OtherBody | None = None,
        triangle_area: float | None = None,
        seed: int = 0,
    ) -> None:
        self.model = model
        self.treatment = treatment or Treatment()
        self.own = own or OwnOptions()
        self.other_body = other_body
        self.body = model.body if other_body is None else other_body.body
        self.clock = clock
        self.seed = seed
        self.space = config_space(model.config)
        self.area = model.config.target_area
        if triangle_area is not None:
            self.area = 1e-4 * check_area(triangle_area)
        self._prepared: dict[tuple[float, ...] | Path, Prepared] = {}
        self._drape = jax.jit(drape, static_argnames="fabric")

    @cached_property
    def landmarks(self) -> Landmarks:
        """Where tapes are laid on the body."""
        return load_landmarks(self.body)

    @cached_property
    def simulator(self) -> Simulator:
        """The solver for the body that is dressed."""
        return Simulator(self.body)

    @property
    def fabrics(self) -> tuple[str, ...]:
        """What can be asked for: the simulator knows more fabrics than the networks."""
        by_simulation = self.treatment.simulate or self.treatment.refine is not None
        return fabric_names() if by_simulation else self.model.config.fabrics

    def check(self, request: Request) -> None:
        """Raise for a request that `drape` would refuse, as far as that can be told without draping.

        Raises:
            ValueError: an unknown fabric or design, numbers out of range, or betas far from what the networks know.
            FileNotFoundError: there is no such mesh.
        """
        check_choice("fabric", request.fabric or self.model.config.fabrics[0], self.fabrics)
        if request.mesh is None:
            resolve_design(self.space, request.cut)
        else:
            check_file("garment", request.mesh)
        for name, value in request.shape.measurements().items():
            check_measurement(name, value)
        num_betas = self.model.config.num_betas if self.other_body is None else self.body.num_betas
        if not request.shape.measurements():
            betas, _ = resolve_betas(self.body, request.shape, num_betas)
            if self.other_body is None and self.treatment.gate:
                judge_betas(betas, known_range(num_betas)).check("this body")
        elif request.shape.betas:
            raise ValueError("give either betas or measurements of the body, not both")

    def drape(self, request: Request) -> Draped:
        """Carry out one request; raises `ValueError` where it makes no sense, `Refused` where the gate says no."""
        model, treatment = self.model, self.treatment
        fabric = check_choice("fabric", request.fabric or model.config.fabrics[0], self.fabrics)
        with self.clock.stage("body"):
            other = self.other_body
            num_betas = model.config.num_betas if other is None else self.body.num_betas
            betas, remarks = resolve_betas(self.body, request.shape, num_betas)
            body_vertices, _ = shape_body(self.body, betas)
            known_betas = betas if other is None else other.nearest_betas(body_vertices)
        far = judge_betas(known_betas, known_range(model.config.num_betas))
        if treatment.gate:
            far.check("this body")
        prepared = self.prepare(request.cut) if request.mesh is None else self.prepare_own(request.mesh)
        learned = fabric if fabric in model.config.fabrics else model.config.fabrics[0]
        with self.clock.stage("drape"):
            padded = self._drape(model, prepared.garment, known_betas, fabric=learned)
            vertices = prepared.garment.unpad(padded)
            if other is not None:
                vertices = other.carry(vertices, self._skinning(prepared), known_betas, betas)
                shape = " ".join(f"{beta:+.2f}" for beta in known_betas)
                remarks.append(f"note     draped on the networks' body of betas {shape}, carried to {self.body.name}")
        if treatment.simulate or treatment.refine is not None:
            with self.clock.stage("simulation"):
                result = self._simulate(vertices, prepared, fabric, betas)
            vertices = result.vertices
            remarks.append(f"{'dressed' if treatment.simulate else 'refined'}  {result.words()}")
        faces = np.asarray(self.body.faces)
        pushed = None
        if treatment.clearance is not None:
            with self.clock.stage("push out"):
                surface = ClosedSurface(np.asarray(body_vertices), faces)
                pushed = push_out(vertices, prepared.faces, surface, treatment.clearance)
            vertices = pushed.vertices.astype(np.float32)
            remarks.append(_words(pushed))
        with self.clock.stage("fit"):
            pattern = (prepared.faces, prepared.uv, prepared.faces_uv)
            fit = measure_fit(body_vertices, faces, self.landmarks, vertices, *pattern, known_fabric(fabric))
        with self.clock.stage("gate"):
            verdict = judge(
                vertices,
                *pattern,
                self.body,
                np.asarray(body_vertices),
                mean=prepared.garment.mean_vertices,
                pushed=pushed,
                clearance=fit.clearance,
            )
        if treatment.gate:
            verdict.check(prepared.label)
        verdict = Verdict((*far.findings, *verdict.findings))
        lines = [
            f"garment  {prepared.label}; {len(vertices)} vertices, {len(prepared.faces)} triangles",
            *prepared.remarks,
            f"fabric   {fabric}",
            *remarks,
            *fit.lines(),
            *verdict.lines(),
        ]
        return Draped((np.asarray(body_vertices), faces), vertices, prepared, betas, fit, fabric, lines, verdict)

    def _simulate(
        self, vertices: Float[np.ndarray, "V 3"], prepared: Prepared, fabric: str, betas: Float[np.ndarray, " b"]
    ) -> Simulated:
        """The drape as the simulator has it: from the learned one, or from the panels alone."""
        cloth = load_fabric(fabric)
        if self.treatment.simulate:
            panels = vertices if prepared.panels is None else prepared.panels
            return self.simulator.dress(panels, prepared.pattern, cloth, betas, self.clock.progress("dressing"))
        steps = self.treatment.refine or None
        return self.simulator.refine(vertices, prepared.pattern, cloth, betas, steps, self.clock.progress("refining"))

    def pose(self, draped: Draped, pose: Float[np.ndarray, "J 3"]) -> Draped:
        """The same body and garment in another pose; the report of the fit stays that of the T-pose."""
        with self.clock.stage("pose"):
            soft = self._skinning(draped.prepared)
            points, faces = draped.body
            posed, garment = pose_dressed(self.model.body, points, draped.vertices, soft, pose.astype(np.float32))
        return replace(draped, body=(np.asarray(posed), faces), vertices=np.asarray(garment))

    def _skinning(self, prepared: Prepared) -> Float[np.ndarray, "V J"]:
        """Skinning weights of the garment on the networks' body."""
        nearest = closest_body_vertices(prepared.garment.mean_vertices, self.model.body)
        return soft_skinning(np.asarray(self.model.body.lbs_weights)[nearest], prepared.faces)

    def prepare(self, cut: Cut) -> Prepared:
        """The garment of a design, made once for each."""
        design = resolve_design(self.space, cut)
        key = tuple(float(v) for v in design.values)
        if key not in self._prepared:
            with self.clock.stage("pattern and mesh"):
                mesh = remesh(self.space, design, self.area, seed=self.seed)
            with self.clock.stage("graph"):
                garment = prepare_mesh(self.model, mesh)
            self._prepared[key] = Prepared(
                garment, mesh.faces, mesh.uv, mesh.faces_uv, str(design), (), design, placement(mesh)
            )
        return replace(self._prepared[key], label=str(design), design=design)

    def prepare_own(self, path: Path) -> Prepared:
        """A garment from a mesh file, put on the mean body and settled there."""
        if path not in self._prepared:
            simulator = Simulator(self.model.body) if self.other_body is not None else self.simulator
            with self.clock.stage("own mesh"):
                progress = self.clock.progress("settling")
                own = bring_own(path, self.model.body, self.own, simulator=simulator, progress=progress)
            with self.clock.stage("graph"):
                garment = prepare(self.model, mesh=own.loaded)
            remarks = tuple(f"note     {remark}" for remark in own.remarks)
            pattern = own.pattern
            self._prepared[path] = Prepared(
                garment, pattern.faces, pattern.uv, pattern.faces_uv, own.name, remarks, None, own.vertices
            )
        return self._prepared[path]


def check_area(triangle_area: float) -> float:
    """Mean area of triangles that cloth can be meshed with, square centimetres, or `ValueError`."""
    return check_range("triangle area", triangle_area, 0.1, 30.0, "cm^2")


def _words(pushed: PushedOut) -> str:
    """What the push out of the body did."""
    before = f"{100 * pushed.inside_before:.2f} % of the cloth lay up to {1e3 * pushed.deepest_before:.1f} mm inside"
    after = "none does now" if pushed.is_outside else f"{100 * pushed.inside:.2f} % still do"
    return f"pushed   {before}, {after}; largest move {1e3 * pushed.largest_move:.1f} mm"
