"""Where a garment from anywhere belongs on the mean body: its unit, vertical axis, facing, origin and arms.

A file says none of these. Each choice is judged by how the cloth would lie on the body: a misfit adds cloth inside the
body, cloth far from it (both over the garment's size, so that no scale is favoured) and cloth that looks another way
than the skin below it. Choices that people make (metres, y up, facing +z, the pelvis at the origin, arms out) are
taken when they are nearly as good as the best.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tryon_jax.checks import check_choice, check_range
from tryon_jax.mesh.normals import vertex_normals
from tryon_jax.mesh.repair import SIZE
from tryon_jax.mesh.units import UNITS, fitting_units
from tryon_jax.types import Body
from tryon_jax.wear.arms import LoweredArms

MOST_MISFIT = 0.06
"""Garments that are on the body have 0.004 to 0.045, the same in a wrong unit 0.075 and more; wide ones are known by
what is inside."""
GOOD_MISFIT = 0.03
"""Below this nothing else is tried."""
UPS = ("y", "z")
"""Vertical axes of files; with z, −y is the front, as in Blender."""
TURNS = (0, 90, 180, 270)
"""Turns about the vertical axis, degrees."""
ARMS = tuple(range(0, 90, 15))
"""Angles below the horizontal that arms are tried at, degrees."""

_SMPL_PELVIS = np.array([-0.002, -0.241, 0.029])
# A convention is kept while its misfit is at most this factor and this much above the best.
_KEEP_FACTOR, _KEEP_MORE = 1.25, 0.004
# Arms show in the sleeves alone.
_KEEP_ARMS_FACTOR, _KEEP_ARMS_MORE = 1.08, 0.001
_SAMPLES = 300
_DEPTH_WEIGHT, _NEAR, _FAR = 3.0, 0.02, 0.22
_FACING_WEIGHT, _FACING_REACH = 0.1, 0.08
# A garment as it is hangs on the body when so few of its points are inside, and half are so near, metres.
_FEW_INSIDE, _HALF_WITHIN = 0.1, 0.12


@dataclass(frozen=True)
class Placing:
    """What a user says of a garment's file; what is left out is found."""

    unit: str | None = None
    """Unit of length: m, dm, cm, mm, in, or metres per unit such as 0.058; found by the size of a person when not
    given."""
    up: str | None = None
    """Vertical axis of the file, y or z; found when not given."""
    turn: int | None = None
    """Turn about the vertical axis to face the front, 0, 90, 180 or 270 degrees; found when not given."""
    offset: tuple[float, float, float] | None = None
    """Shift in metres (to the left, up, to the front) of a garment whose pelvis is at the origin; found when not
    given."""
    pose_of_garment: str | None = None
    """Pose that the garment was made on: t, a (arms 45 degrees down) or degrees; found by the sleeves if not given."""

    def check(self) -> None:
        """Raise `ValueError` for a value that is out of range."""
        if self.unit is not None:
            self.metres()
        if self.up is not None:
            check_choice("up axis", self.up, UPS)
        if self.turn is not None and self.turn not in TURNS:
            raise ValueError(f"turn = {self.turn} degrees is none of {', '.join(map(str, TURNS))}")
        for axis, value in zip(("left", "up", "front"), self.offset or (), strict=False):
            check_range(f"offset to the {axis}" if axis != "up" else "offset up", value, -3.0, 3.0, "m")
        self.degrees()

    def metres(self) -> float | None:
        """Metres per unit, where it is given."""
        if self.unit is None or self.unit in UNITS:
            return None if self.unit is None else UNITS[self.unit]
        try:
            return check_range("unit", float(self.unit), 1e-5, 100.0, "m")
        except ValueError as error:
            if "outside" in str(error):
                raise
            known = ", ".join(UNITS)
            raise ValueError(f"unknown unit {self.unit!r}; known: {known}, or metres per unit such as 0.058") from None

    def degrees(self) -> float | None:
        """How far the arms are lowered, where it is given."""
        if self.pose_of_garment is None:
            return None
        named = {"t": 0.0, "a": 45.0}
        if self.pose_of_garment.lower() in named:
            return named[self.pose_of_garment.lower()]
        try:
            return check_range("pose of the garment", float(self.pose_of_garment), 0.0, 85.0, "degrees")
        except ValueError as error:
            if "outside" in str(error):
                raise
            raise ValueError(f"pose of the garment must be t, a or degrees, got {self.pose_of_garment!r}") from None


@dataclass(frozen=True, eq=False)
class Placement:
    """How a file's coordinates become a garment on the mean body."""

    unit: str
    metres: float
    """In one unit of the file."""
    up: str
    turn: int
    """Degrees about the vertical axis."""
    shift: Float[np.ndarray, "3"]
    """Metres, after all else."""
    arms: float
    """Degrees below the horizontal at which the garment's sleeves hang."""
    misfit: float
    """0 for wide cloth that surrounds the body as it is."""
    origin: str = "the pelvis"
    """What the file has at its origin, in words; empty for a place of its own."""

    def points(self, vertices: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Vertices of the file, metres, in the frame of the body; arms are still down."""
        return self.directions(vertices) * self.metres + self.shift

    def directions(self, vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Vectors of the file, turned."""
        x, y, z = vectors.T if self.up == "y" else (vectors[:, 0], vectors[:, 2], -vectors[:, 1])
        cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[self.turn]
        return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1)

    def words(self) -> list[str]:
        """What was found, one sentence each; nothing for a garment that is where it belongs."""
        said = []
        if self.metres != 1.0:
            said.append(f"took lengths as {self.unit}")
        if self.up != "y":
            said.append(f"took {self.up} as the vertical axis")
        if self.turn:
            said.append(f"turned it by {self.turn} degrees to face the front")
        if self.origin and self.origin != "the pelvis":
            said.append(f"took its origin for {self.origin}")
        if self.shift.any():
            x, y, z = 100 * self.shift
            said.append(f"moved it by ({x:+.1f}, {y:+.1f}, {z:+.1f}) cm (to the left, up, to the front)")
        if self.arms:
            said.append(f"took its arms to hang {self.arms:g} degrees down and raised them")
        return said


def place(
    vertices: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    body: Body,
    placing: Placing | None = None,
    name: str = "the garment",
) -> Placement:
    """Find where a garment belongs on the mean shape of `body`.

    Args:
        vertices: its vertices, in the file's unit and axes.
        normals: their unit normals, to the outside.
        body: the body, T-pose, metres.
        placing: what is known already.
        name: what messages call it.

    Raises:
        ValueError: its size is a garment's in no unit, or it lies nowhere on the body as a garment does.
    """
    placing = placing or Placing()
    placing.check()
    search = _Search(vertices, normals, body, placing)
    units = _units(float(np.ptp(vertices, axis=0).max()), placing, name)
    best = search.best(units)
    if placing.offset is None and best.misfit > MOST_MISFIT:
        raise ValueError(_lost(name, best, search))
    return best


def _units(size: float, placing: Placing, name: str) -> dict[str, float]:
    """Units to try, metres each."""
    metres = placing.metres()
    if metres is not None:
        if not SIZE[0] <= size * metres < SIZE[1]:
            raise ValueError(
                f"{name} is {size:g} units of {placing.unit} across, {size * metres:.3g} m: a garment has "
                f"{SIZE[0]:g} to {SIZE[1]:g} m"
            )
        return {str(placing.unit) if placing.unit in UNITS else f"{placing.unit} m": metres}
    units = fitting_units(size, *SIZE)
    if not units:
        raise ValueError(
            f"{name} is {size:g} units across: no garment ({SIZE[0]:g} to {SIZE[1]:g} m) in {', '.join(UNITS)}; give "
            "its unit, or metres per unit such as 0.058"
        )
    return {unit: UNITS[unit] for unit in units}


class _Search:
    """Tries placements of one garment on one body."""

    def __init__(self, vertices: np.ndarray, normals: np.ndarray, body: Body, placing: Placing) -> None:
        chosen = np.random.default_rng(0).permutation(len(vertices))[:_SAMPLES]
        self.vertices, self.normals = vertices[chosen], normals[chosen]
        self.size = float(np.ptp(vertices, axis=0).max())
        self.middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self.placing = placing
        degrees = placing.degrees()
        self.arms = ARMS if degrees is None else (degrees,)
        self.skins = {angle: _Skin(LoweredArms(body, angle)) for angle in self.arms}
        low, high = np.asarray(body.v_template)[:, 1].min(), np.asarray(body.v_template)[:, 1].max()
        self.origins = {
            "the pelvis": np.zeros(3),
            "SMPL's": -_SMPL_PELVIS,
            "the floor between the feet": np.array([0.0, low, 0.0]),
            "the middle of the body": np.array([0.0, 0.5 * (low + high), 0.0]),
        }

    def judged(self, placement: Placement, shifts: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, " S"]:
        """Misfit of a placement with other shifts."""
        points = replace(placement, shift=np.zeros(3)).points(self.vertices)
        return self.skins[placement.arms].misfit(
            points + shifts[:, None], placement.directions(self.normals), self.size * placement.metres
        )

    def best(self, units: dict[str, float]) -> Placement:
        """The best placement, or a usual one that is nearly as good."""
        placing = self.placing
        start = [p for p in self._choices(units) if placing.offset is None or p.arms == self.arms[0]]
        if placing.offset is not None:
            shift = np.asarray(placing.offset, float)
            return min((self._armed(replace(p, shift=shift)) for p in start), key=lambda p: p.misfit)
        usual = [self._armed(p) for p in start if p.arms == self.arms[0] and p.up == "y" and p.turn == 0]
        best = min(usual, key=lambda p: p.misfit, default=None)
        if best is not None and best.misfit <= GOOD_MISFIT:
            return best
        out = [replace(p, arms=self.arms[0]) for p in usual]
        hanging = [p for p in out if self.skins[p.arms].is_inside_of(p.points(self.vertices))]
        if hanging:
            return replace(hanging[0], misfit=0.0)
        found = [self._refined(p) for p in self._scanned(start)]
        least = min(found, key=lambda p: p.misfit)
        # In the order of what is usual.
        for known in sorted(found, key=lambda p: (p.metres != least.metres, p.up != "y", p.turn != 0, p.misfit)):
            if known.metres == least.metres and self._keeps(known.misfit, least.misfit):
                return self._named(known)
        return self._named(least)

    @staticmethod
    def _keeps(misfit: float, least: float) -> bool:
        return misfit <= _KEEP_FACTOR * least + _KEEP_MORE

    def _choices(self, units: dict[str, float]) -> Iterator[Placement]:
        placing = self.placing
        for unit, metres in units.items():
            for up in UPS if placing.up is None else (placing.up,):
                for turn in TURNS if placing.turn is None else (placing.turn,):
                    for arms in self.arms:
                        yield Placement(unit, metres, up, turn, np.zeros(3), arms, np.inf)

    def _scanned(self, choices: list[Placement]) -> list[Placement]:
        """For each unit, axis and turn the best of all heights, depths and some arms."""
        few = self.arms[:: max(1, len(self.arms) // 3)]
        best: dict[tuple, Placement] = {}
        for choice in choices:
            if choice.arms not in few:
                continue
            centre = choice.points(self.middle[None])[0]
            heights, depths = np.meshgrid(np.arange(-0.9, 0.9, 0.05), (-0.06, 0.0, 0.06))
            shifts = np.stack([np.zeros(heights.size), heights.ravel(), depths.ravel()], axis=1) - centre
            shifts = np.concatenate([np.stack(list(self.origins.values())), shifts])
            misfits = self.judged(choice, shifts)
            k = int(np.argmin(misfits))
            one = replace(choice, shift=shifts[k], misfit=float(misfits[k]))
            key = (choice.unit, choice.up, choice.turn)
            if key not in best or one.misfit < best[key].misfit:
                best[key] = one
        least = min(one.misfit for one in best.values())
        return [one for one in best.values() if one.misfit < 2 * least + 0.01]

    def _refined(self, placement: Placement) -> Placement:
        """A nearby best, by steps of 4 cm down to half a centimetre, with arms between."""
        placement = self._armed(placement)
        step = 0.04
        ways = np.array([[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]], float)
        while step > 0.004:
            shifts = placement.shift + step * ways
            misfits = self.judged(placement, shifts)
            k = int(np.argmin(misfits))
            if misfits[k] < placement.misfit:
                placement = replace(placement, shift=shifts[k], misfit=float(misfits[k]))
            else:
                step /= 2
                placement = self._armed(placement)
        return placement

    def _armed(self, placement: Placement) -> Placement:
        """With the arms that suit it best; out where that is nearly as good."""
        tried = [replace(placement, arms=angle) for angle in self.arms]
        tried = [replace(one, misfit=float(self.judged(one, one.shift[None])[0])) for one in tried]
        least = min(tried, key=lambda one: one.misfit)
        most = _KEEP_ARMS_FACTOR * least.misfit + _KEEP_ARMS_MORE
        return tried[0] if tried[0].misfit <= most else least

    def _named(self, placement: Placement) -> Placement:
        """With one of the usual origins where that is nearly as good."""
        for name, shift in self.origins.items():
            one = self._armed(replace(placement, shift=shift, origin=name))
            if self._keeps(one.misfit, placement.misfit):
                return one
        return replace(placement, origin="")

    def closest_scale(self, placement: Placement) -> float:
        """Metres per unit at which the garment would fit best."""
        tried = [
            replace(placement, metres=extent / self.size, arms=self.arms[0]) for extent in np.geomspace(0.4, 1.8, 16)
        ]
        return min((self._scanned([one])[0] for one in tried), key=lambda one: one.misfit).metres


class _Skin:
    """A body to measure misfits on."""

    def __init__(self, body: LoweredArms) -> None:
        self.vertices = body.vertices
        self.normals = vertex_normals(self.vertices, np.asarray(body.body.faces))
        self._tree = cKDTree(self.vertices)

    def is_inside_of(self, points: Float[np.ndarray, "N 3"]) -> bool:
        """Whether points of a garment surround the body: hardly any inside it, and half of them near."""
        distance, nearest = self._tree.query(points)
        inside = np.einsum("nc,nc->n", points - self.vertices[nearest], self.normals[nearest]) < 0
        low, high = points.min(axis=0), points.max(axis=0)
        around = bool((low[[0, 2]] < 0).all() and (high[[0, 2]] > 0).all())
        return bool(around and inside.mean() <= _FEW_INSIDE and np.median(distance) <= _HALF_WITHIN)

    def misfit(
        self, points: Float[np.ndarray, "S N 3"], normals: Float[np.ndarray, "N 3"], size: float
    ) -> Float[np.ndarray, " S"]:
        """Of a garment of `size` metres at several places; by the closest vertices, which is near enough."""
        distance, nearest = self._tree.query(points)
        out = self.normals[nearest]
        inside = np.einsum("snc,snc->sn", points - self.vertices[nearest], out) < 0
        off = np.where(inside, _DEPTH_WEIGHT * distance, np.clip(distance, _NEAR, _FAR) - _NEAR)
        # Cloth far from the skin, as of a skirt between the legs, may look elsewhere.
        turned = (1 - np.einsum("snc,nc->sn", out, normals)) * np.clip(1 - distance / _FACING_REACH, 0, 1)
        return off.mean(axis=1) / size + _FACING_WEIGHT * turned.mean(axis=1)


def _lost(name: str, best: Placement, search: _Search) -> str:
    """Why a garment is refused, with what to try."""
    metres = search.closest_scale(best)
    return (
        f"{name} fits nowhere on the body in a usual unit (best in {best.unit}: misfit {best.misfit:.3f}, at most "
        f"{MOST_MISFIT:g}); at {metres:.3g} m per unit it would come closest. Give its unit (also as metres per unit), "
        "up axis and offset, or choose the pieces that are cloth"
    )
