"""The garments of a session: cut from designs, or brought by users; prepared once."""

from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from tryon_jax.checks import check_file
from tryon_jax.garment import Design, remesh
from tryon_jax.garment.near_design import mesh_of_near_design
from tryon_jax.graph.buckets import bucket_size
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.tryon import TryOnModel, config_space, design_of
from tryon_jax.types import Body
from tryon_jax.wear.last_used import LastUsed
from tryon_jax.wear.own import OwnGarment, OwnOptions, bring_own
from tryon_jax.wear.prepared import PreparedGarment, prepared_design, prepared_near, prepared_own
from tryon_jax.wear.session_bodies import SessionBodies
from tryon_jax.wear.simulate import Progress, Simulator
from tryon_jax.wear.stopwatch import Stopwatch

DesignLike = Design | Mapping[str, float] | Sequence[float] | str | None
"""A design: parameters in metres by name or in order, the name of a preset, or None for the mean design."""

_GARMENTS = 16


class SessionGarments(SessionBodies):
    """The garments that a session drapes on its bodies; the base of `Session`."""

    def __init__(
        self, model: TryOnModel, body: Body | None, bodies_kept: int, triangle_area: float | None, one_size: bool
    ) -> None:
        """Prepare nothing yet.

        Args:
            model: Drapes the garments.
            body: A body to dress in place of the networks' own one.
            bodies_kept: Body shapes that are kept.
            triangle_area: Mean area of the triangles of garments, square metres; that of the training data when None.
            one_size: Pad the garments of all designs to the size of the largest.
        """
        super().__init__(model, body, bodies_kept)
        self.space = config_space(model.config)
        self.triangle_area = model.config.target_area if triangle_area is None else triangle_area
        self._one_size = one_size
        self._garments: LastUsed[PreparedGarment] = LastUsed(_GARMENTS)

    def prepare(
        self,
        design: DesignLike = None,
        *,
        mesh: str | Path | LoadedGarment | OwnGarment | None = None,
        own: OwnOptions | None = None,
        label: str | None = None,
        seed: int = 0,
        near: PreparedGarment | None = None,
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
            near: A garment of another design, from here. If the design is near, its triangles are moved with the
                pattern, which takes a sixth of the time; the drape differs as that of another mesh does.
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

        if near is not None and key not in self._garments:
            moved = self._moved(near.near or near, wanted, seed, watch)
            if moved is not None:
                return moved
        return self._garments.get(key, make)

    def _moved(self, near: PreparedGarment, wanted: Design, seed: int, watch: Stopwatch) -> PreparedGarment | None:
        """The garment on the triangles of a near design; None where that one is too far or was made otherwise."""
        mesh = near.mesh
        if mesh is None or near.garment.own is not None or (mesh.seed, mesh.target_area) != (seed, self.triangle_area):
            return None
        with watch.stage("pattern and mesh"):
            cut = mesh_of_near_design(self.space, mesh, wanted)
        if cut is None:
            return None
        with watch.stage("graph"):
            return prepared_near(self.model, cut, near)

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

        return self._garments.get(key, make)

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
