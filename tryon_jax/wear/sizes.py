"""Sizes of a garment tried on one body: how each sits, and which comes nearest to what is asked for."""

from collections.abc import Sequence
from dataclasses import dataclass

from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.fit import Fit
from tryon_jax.wear.session import Session
from tryon_jax.wear.session_bodies import Betas
from tryon_jax.wear.session_garments import DesignLike
from tryon_jax.wear.stopwatch import Stopwatch
from tryon_jax.wear.tailor import HEM, NOT_ROUND, FitTarget, sitting


@dataclass(frozen=True, eq=False)
class Size:
    """One size on the body."""

    name: str
    target: FitTarget
    dressed: DressedBody
    got: dict[str, float | None]
    """What it has of everything that the target names, metres; None where the garment does not go round."""

    @property
    def fit(self) -> Fit:
        """How it sits."""
        assert self.dressed.fit is not None
        return self.dressed.fit

    @property
    def wearable(self) -> bool:
        """Neither too tight to be put on nor refused by the gate."""
        verdict = self.dressed.verdict
        return not self.fit.too_tight and (verdict is None or verdict.outcome != "refused")

    @property
    def miss(self) -> float:
        """Root of the summed squares of what it is off, metres."""
        asked = self.target.as_dict()
        return sum((NOT_ROUND if v is None else v - asked[k]) ** 2 for k, v in self.got.items()) ** 0.5

    def words(self) -> str:
        """How it sits, in one line."""
        parts = [_got(name, value) for name, value in self.got.items()]
        if self.fit.too_tight:
            parts.append(f"too tight at the {' and '.join(self.fit.too_tight)}")
        elif not self.wearable:
            parts.append("cannot be worn")
        return f"{self.name}: {', '.join(parts)}"

    def caption(self) -> str:
        """For a picture."""
        return f"{self.name}: {', '.join(_got(name, value) for name, value in self.got.items())}"

    def reason(self, sizes: Sequence["Size"]) -> str:
        """Why it is the one, among all that were tried.

        Args:
            sizes: All of them.
        """
        asked = self.target.as_dict()
        off = ", ".join(
            f"{name} {100 * (value - asked[name]):+.1f} cm off" for name, value in self.got.items() if value is not None
        )
        tight = [size.name for size in sizes if not size.wearable]
        others = f"; {', '.join(tight)} cannot be worn" if tight else ""
        return f"nearest to what is asked for ({off}){others}"


def try_size(
    session: Session,
    name: str,
    design: DesignLike,
    betas: Betas,
    target: FitTarget,
    *,
    fabric: str | None = None,
    stopwatch: Stopwatch | None = None,
) -> Size:
    """One size, draped on the body, pushed out of it, measured and judged.

    Args:
        session: Drapes it.
        name: Of the size.
        design: Of the size, as in `Session.prepare`.
        betas: The body, as in `Session.shape`.
        target: What a size is chosen by.
        fabric: One of the session's; its first by default.
        stopwatch: Takes the time of each step.
    """
    garment = session.prepare(design, stopwatch=stopwatch)
    dressed = session.try_on(garment, betas, fabric=fabric, stopwatch=stopwatch)
    return Size(name, target, dressed, sitting(dressed, session, target))


def best_size(sizes: Sequence[Size]) -> Size | None:
    """The wearable size that comes nearest to its target; None where none can be worn.

    Args:
        sizes: From `try_size`.
    """
    return min((size for size in sizes if size.wearable), key=lambda size: size.miss, default=None)


def _got(name: str, value: float | None) -> str:
    if value is None:
        return f"does not go round the {name}"
    return f"hem {100 * value:.1f} cm over the floor" if name == HEM else f"ease {100 * value:+.1f} cm at the {name}"
