"""Made to measure: the design whose drape on one body has the ease and the hem that are asked for.

Each length that is asked for frees the design parameter that moves it most; the others stay as they were. In each round
Levenberg-Marquardt finds the design through the differentiable mean drape M̄, with the displacement from it held: a
derivative through the networks would take far longer to compile. The garment is then cut anew, draped, pushed out of
the body and, where asked, brought to rest by the simulator. Broyden's rank-one update (Broyden 1965) turns what its
exact lengths are off into a correction of the derivative for the next round.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tryon_jax.checks import check_choice, check_range
from tryon_jax.garment import Design, DesignSpace
from tryon_jax.tryon import Garment, TryOnModel, mean_drape
from tryon_jax.types import ArrayLike, pytree
from tryon_jax.wear.dressed import DressedBody, ShapedBody
from tryon_jax.wear.fit import EASE_AT, girth_round, tape_place
from tryon_jax.wear.session import Session
from tryon_jax.wear.session_bodies import Betas
from tryon_jax.wear.session_garments import DesignLike
from tryon_jax.wear.stopwatch import Stopwatch
from tryon_jax.wear.tape import Tapes, girths_and_hem, make_tapes
from tryon_jax.wear.unknowns import Unknowns, solve

HEM = "hem"
_FREE, _HELD = 0.1, 1e4
"""Millimetres that a parameter one half range from where it started costs, freed and held."""
_STEPS = 20
_ENOUGH = {**dict.fromkeys(EASE_AT, 0.002), HEM: 0.001}
"""Metres: what is nearer than this needs no further round."""
_SAME = 1e-4
"""Half ranges: a design that changes by no more is the same, and another round would find it again."""
NOT_ROUND = 0.1
"""Metres that a tape counts as missed by which the garment does not go round."""


@dataclass(frozen=True)
class FitTarget:
    """How a garment shall sit. What is left out stays as the design has it."""

    ease: Mapping[str, float] = field(default_factory=dict)
    """Garment's minus body's girth at those of "chest", "waist" and "hip" that matter, metres."""
    hem: float | None = None
    """Mean height of the hem over the floor, metres."""

    def __post_init__(self) -> None:
        for name, ease in self.ease.items():
            check_range(f"ease at the {check_choice('place of the ease', name, EASE_AT)}", ease, -0.2, 1.0, "m")
        if self.hem is not None:
            check_range("height of the hem", self.hem, 0.0, 1.6, "m")
        if not self.ease and self.hem is None:
            raise ValueError("a fit needs an ease at chest, waist or hip, or a height of the hem")

    def as_dict(self) -> dict[str, float]:
        """All that is asked for by name, metres."""
        return {**self.ease, **({} if self.hem is None else {HEM: self.hem})}


@dataclass(frozen=True, eq=False)
class Tailored:
    """The design that was found, and how it sits."""

    target: FitTarget
    design: Design
    dressed: DressedBody
    """The learned drape, pushed out of the body and measured."""
    predicted: dict[str, float | None]
    """What the learned drape has of everything that was asked for, metres; None where the garment does not go round."""
    simulated: dict[str, float | None] | None = None
    """The same of the drape at rest, where the simulator was asked."""
    refined: DressedBody | None = None
    """The drape at rest, where the simulator was asked."""
    rounds: int = 0
    """After how many rounds it was found."""

    @property
    def got(self) -> dict[str, float | None]:
        """What it has of everything that was asked for, metres: by the simulator where it was asked."""
        return self.predicted if self.simulated is None else self.simulated

    @property
    def misses(self) -> dict[str, float | None]:
        """`got` minus what was asked for, metres."""
        return {name: _minus(self.got[name], asked) for name, asked in self.target.as_dict().items()}

    def at_bounds(self, space: DesignSpace) -> dict[str, str]:
        """Design parameters at an end of their range: "smallest" or "largest" by name."""
        near = 1e-3 * (space.maximum - space.minimum)
        low, high = self.design.values <= space.minimum + near, self.design.values >= space.maximum - near
        ends = {name: "smallest" for name, at in zip(space.names, low, strict=True) if at}
        return ends | {name: "largest" for name, at in zip(space.names, high, strict=True) if at}


def tailor(
    session: Session,
    target: FitTarget,
    betas: Betas = (),
    *,
    start: DesignLike = None,
    fabric: str | None = None,
    refine: bool = False,
    rounds: int = 5,
    stopwatch: Stopwatch | None = None,
) -> Tailored:
    """The design whose garment sits on a body as asked; the nearest one where no design can.

    Args:
        session: Of the networks' body.
        target: Ease and hem that are asked for.
        betas: The body, as in `Session.shape`.
        start: The design to change, as in `Session.prepare`; what the target leaves open stays as in it.
        fabric: One of the session's; its first by default.
        refine: Bring each round's drape to rest by the simulator and correct by that.
        rounds: How often at most the garment is cut anew.
        stopwatch: Takes the time of each step.

    Raises:
        ValueError: Values out of range, or a session that dresses another body than the networks'.
    """
    if session.other is not None:
        raise ValueError("tailoring is for the networks' body; another body is dressed by approximation")
    check_range("rounds", rounds, 1, 20)
    watch = stopwatch or Stopwatch()
    fabric = session.check_fabric(fabric)
    body = session.shape(betas, stopwatch=watch)
    unknowns = Unknowns.of(session.space)
    wanted, weights = _wanted_lengths(target, body)
    correction = np.zeros((len(wanted), len(session.space.names)), np.float32)

    def sit(design: DesignLike) -> tuple[Tailored, _Lengths]:
        garment = session.prepare(design, stopwatch=watch)
        learned = session.drape(garment, betas, fabric=fabric, stopwatch=watch)
        with watch.stage("solve"):
            lengths = _Lengths.of(session, learned, unknowns)
        return _measured(session, target, learned, refine, watch), lengths

    result, lengths = sit(start)
    on_mean = session.drape(result.dressed.garment, (), fabric=fabric, stopwatch=watch)
    freed = _freed(_Lengths.of(session, on_mean, unknowns), weights)
    held = np.where(freed, _FREE, _HELD).astype(np.float32)
    first = lengths.units
    for k in range(rounds):
        if _near_enough(result):
            break
        at = np.asarray(lengths.units)
        offset = _offset(result, body, lengths)
        with watch.stage("solve"):
            problem = (lengths, offset, correction, wanted, weights, first, held)
            units = np.clip(solve(_residuals, at, problem, _STEPS).units, -1.0, 1.0)
        step = units - at
        if np.abs(step).max() < _SAME:
            break
        values = np.clip(np.asarray(unknowns.values(units), float), session.space.minimum, session.space.maximum)
        trial, trial_lengths = sit(session.space.from_values(values))
        other = (trial, units)
        # A round that got worse has told something of the derivative; the next begins where the last good one did.
        if _cost(trial) < _cost(result):
            other = (result, at)
            result, lengths = replace(trial, rounds=k + 1), trial_lengths
        _correct(correction, result, lengths, body, *other)
    return result


def _correct(
    correction: Float[np.ndarray, "L U"],
    result: Tailored,
    lengths: "_Lengths",
    body: ShapedBody,
    other: Tailored,
    units: Float[np.ndarray, " U"],
) -> None:
    """Broyden's update: from the best design so far, the corrected lengths are right at another one too.

    The lengths' own derivative is that of the best design. Where a tape slips over the sleeves it may have the wrong
    sign elsewhere, and a correction for that does not hold here.

    Args:
        correction: Of the derivative; changed in place.
        result: The best design.
        lengths: Of it.
        body: The body.
        other: Another design.
        units: Of it.
    """
    step = units - np.asarray(lengths.units)
    expected = lengths.held(units) + _offset(result, body, lengths) + correction @ step
    correction += np.outer(_lengths_of(other, body, expected) - expected, step) / (step @ step)


def _offset(result: Tailored, body: ShapedBody, lengths: "_Lengths") -> Float[np.ndarray, " L"]:
    """By which exact lengths on the finished drape differ from those that the derivative is of, metres."""
    found = lengths.held(np.asarray(lengths.units))
    return _lengths_of(result, body, found) - found


def sitting(dressed: DressedBody, session: Session, target: FitTarget) -> dict[str, float | None]:
    """What a drape has of everything that a target names, by the cloth's exact lengths, metres.

    Args:
        dressed: The drape.
        session: Knows where tapes are laid.
        target: Names ease and hem.
    """
    mesh = dressed.garment.mesh
    vertices = dressed.vertices.astype(np.float64)
    found: dict[str, float | None] = {}
    for name in target.ease:
        girth = girth_round(vertices, dressed.faces, *tape_place(session.landmarks, name, _exact(dressed.body)))
        found[name] = _minus(girth, dressed.body.measurements[name])
    if target.hem is not None:
        assert mesh is not None
        found[HEM] = float(vertices[np.asarray(mesh.loops["hem"]), 1].mean()) - _ground(dressed.body)
    return found


def _measured(session: Session, target: FitTarget, learned: DressedBody, refine: bool, watch: Stopwatch) -> Tailored:
    dressed = session.judge(session.push_out(learned, stopwatch=watch), stopwatch=watch)
    refined = simulated = None
    if refine:
        refined = session.push_out(session.refine(learned, stopwatch=watch), stopwatch=watch)
        refined = session.judge(refined, stopwatch=watch)
        simulated = sitting(refined, session, target)
    assert learned.garment.design is not None
    return Tailored(target, learned.garment.design, dressed, sitting(dressed, session, target), simulated, refined)


@pytree
class _Lengths:
    """Lengths of a garment on a body as a function of the design, with the displacement from M̄ held."""

    model: TryOnModel
    garment: Garment
    moved: Float[ArrayLike, "N 3"]
    """From M̄ to the drape, metres."""
    unknowns: Unknowns
    tapes: Tapes
    units: Float[ArrayLike, " U"]
    """The design at which the displacement is right."""

    @classmethod
    def of(cls, session: Session, learned: DressedBody, unknowns: Unknowns) -> "_Lengths":
        """Of a learned drape."""
        garment, mesh = learned.garment.garment, learned.garment.mesh
        assert mesh is not None
        moved = np.zeros(np.asarray(garment.graph.vertices).shape, np.float32)
        moved[: len(learned.vertices)] = learned.vertices - garment.mean_vertices
        body = learned.body
        tapes = make_tapes(garment, mesh, session.body, _places(session, body), _ground(body))
        return cls(session.model, garment, moved, unknowns, tapes, unknowns.units(mesh.design.values))

    def at(self, units: Float[Array, " U"]) -> Float[Array, " L"]:
        """Girth of the cloth at each of `EASE_AT`, then the height of the hem; metres."""
        mean = mean_drape(self.model, self.garment, self.unknowns.values(units))
        return girths_and_hem(self.tapes, mean + jnp.asarray(self.moved))

    def held(self, units: Float[np.ndarray, " U"]) -> Float[np.ndarray, " L"]:
        """`at`, compiled, on the host."""
        return np.asarray(_at(self, jnp.asarray(units)))


_at = jax.jit(lambda lengths, units: lengths.at(units))
_slope = jax.jit(lambda lengths: jax.jacfwd(lengths.at)(jnp.asarray(lengths.units)))


def _residuals(units: Float[Array, " U"], problem: Any) -> Float[Array, " R"]:
    """Millimetres by which lengths miss, and by which parameters left where they were held."""
    lengths, offset, correction, wanted, weights, first, held = problem
    reached = lengths.at(units) + offset + correction @ (units - lengths.units)
    return jnp.concatenate([1e3 * weights * (reached - wanted), held * (units - first), lengths.unknowns.beyond(units)])


def _freed(lengths: _Lengths, weights: Float[np.ndarray, " L"]) -> Bool[np.ndarray, " U"]:
    """The parameters that move the lengths asked for most, metre for metre, one for each.

    Args:
        lengths: On the mean body: on some others a tape cuts the sleeves as well.
        weights: 1 for each length that is asked for.
    """
    slope = np.abs(np.asarray(_slope(lengths)) / np.asarray(lengths.unknowns.scale))
    freed = np.zeros(slope.shape[1], bool)
    freed[slope[weights > 0].argmax(axis=1)] = True
    return freed


def _wanted_lengths(target: FitTarget, body: ShapedBody) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, " L"]]:
    """Girths and height of the hem that are asked for, metres, and 1 where one is."""
    asked = target.as_dict()
    lengths = [asked.get(name, 0.0) + (0.0 if name == HEM else body.measurements[name]) for name in (*EASE_AT, HEM)]
    return np.asarray(lengths, np.float32), np.array([name in asked for name in (*EASE_AT, HEM)], np.float32)


def _lengths_of(result: Tailored, body: ShapedBody, otherwise: Float[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
    """Exact lengths of what a target names, metres; `otherwise` for the rest and where a tape is not gone round."""
    got, lengths = result.got, np.array(otherwise, np.float32)
    for k, name in enumerate((*EASE_AT, HEM)):
        value = got.get(name)
        if value is not None:
            lengths[k] = value if name == HEM else value + body.measurements[name]
    return lengths


def _near_enough(result: Tailored) -> bool:
    return all(miss is not None and abs(miss) < _ENOUGH[name] for name, miss in result.misses.items())


def _places(session: Session, body: ShapedBody) -> list[tuple[np.ndarray, np.ndarray]]:
    return [tape_place(session.landmarks, name, _exact(body)) for name in EASE_AT]


def _exact(body: ShapedBody) -> Float[np.ndarray, "B 3"]:
    return body.vertices.astype(np.float64)


def _ground(body: ShapedBody) -> float:
    return float(body.vertices[:, 1].min())


def _minus(value: float | None, other: float) -> float | None:
    return None if value is None else value - other


def _cost(result: Tailored) -> float:
    """Misses in units of what is near enough; a tape that the garment does not go round counts as a decimetre."""
    misses = result.misses.items()
    return float(sum(((NOT_ROUND if miss is None else miss) / _ENOUGH[name]) ** 2 for name, miss in misses))
