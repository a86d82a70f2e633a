"""One visitor's page: what happens when a control is moved, and what is shown."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from tryon_jax.files.export import CLOTH, SKIN, Material, mesh_part, write_glb
from tryon_jax.render.fit_maps import map_colors
from tryon_jax.render.picture import background
from tryon_jax.render.scene import srgb_value
from tryon_jax.viewer.controls import CUSTOM, DOWNLOADS, PLAIN, Controls
from tryon_jax.viewer.downloads import (
    command_line,
    legend,
    mesh_file,
    pattern_file,
    picture_file,
    through_file,
)
from tryon_jax.viewer.latest import Latest
from tryon_jax.viewer.page_model import LAYERS, PageModel, Result, ShownMesh, UploadedMesh
from tryon_jax.viewer.simulation import Kind, Simulation
from tryon_jax.viewer.upload import read_upload, refuse_large_uploads
from tryon_jax.wear.dressed import DressedBody

_BEGUN: dict[Kind, str] = {
    "refine": "bringing the drape to rest …",
    "dress": "dressing the mean body …",
    "arms": "lowering the arms …",
}
# Metres: where the simulation stands, and half the side of the floor.
_BESIDE, _FLOOR = 1.9, 3.0
_STILL = 0.3
"""Seconds without a new request after which a garment on moved triangles is made anew."""
_SIMULATED = Material(color=(0.69, 0.44, 0.35), roughness=0.9, double_sided=True)


class Page:
    """Controls and scene of one client of the server.

    Two threads of its own follow the controls. One drapes at once; the other then pushes the cloth out of the body and
    measures the fit. Both work on the latest settings only, so that no time is spent on positions that a moving slider
    has left.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        model: PageModel,
        *,
        own: UploadedMesh | None = None,
        source: tuple[str, ...] = (),
    ) -> None:
        """Build the page of one visitor.

        Args:
            client: The connection of one browser.
            model: What the page computes.
            own: A mesh in place of a design.
            source: Options of the command line for model and body.
        """
        self.client = client
        self.model = model
        self.source = source
        self.settings = model.start()
        self.result: Result | None = None
        # When the controls were last moved, and how long it took until the drape was seen.
        self._asked_at = time.perf_counter()
        self._waited = 0.0
        self._drawing = threading.RLock()
        self._shown: dict[str, tuple[object, np.ndarray, Any]] = {}
        self._simulation: Simulation | None = None
        # Measurements that the visitor has set, metres.
        self._asked: dict[str, float] = {}
        self._set_scene()
        self.controls = Controls(client.gui, model)
        self._computing = Latest(self._work_on_settings, self._say)
        self._finishing = Latest(self._work_on_finish, self._say)
        refuse_large_uploads(client, self._say)
        self._listen()
        if own is None:
            self._computing.give(self.settings)
        else:
            self._wear(own)

    def close(self) -> None:
        """Stop the threads and a simulation that runs; the visitor has left."""
        self._computing.close()
        self._finishing.close()
        if self._simulation is not None:
            self._simulation.cancel()

    # Controls

    def _set_scene(self) -> None:
        scene = self.client.scene
        # Lamps instead of a photographed surrounding, which the page would have to fetch from elsewhere.
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(190, 185, 180), intensity=1.6)
        scene.add_light_directional("/key", intensity=1.9, position=(-2.0, 2.5, 2.5), cast_shadow=True)
        # The pale studio of the pictures: a wall that runs into the floor, of which only shadows are seen.
        wall = np.broadcast_to(srgb_value(background(256, 1)), (256, 16, 3))
        scene.set_background_image(np.round(255 * wall).astype(np.uint8), format="png")
        x, z = np.array([-_FLOOR, _FLOOR, _FLOOR, -_FLOOR]), np.array([_FLOOR, _FLOOR, -_FLOOR, -_FLOOR])
        self._floor = scene.add_mesh_simple(
            "/floor",
            np.stack([x, np.zeros(4), z], axis=1).astype(np.float32),
            np.array([[0, 1, 2], [0, 2, 3]]),
            opacity=0.0,
            cast_shadow=False,
            receive_shadow=0.25,
        )

    def _listen(self) -> None:
        controls = self.controls
        for handle in controls.design:
            self._on_change(handle, self._take_design)
        for handle in (controls.fabric, controls.seed, controls.push_out, controls.arms):
            self._on_change(handle, self._changed)
        for handle in controls.betas:
            self._on_change(handle, self._take_betas)
        for name, handle in controls.tapes.items():
            self._on_change(handle, self._take_measurement, name)
        self._on_change(controls.preset, self._take_preset)
        for handle in (controls.layer, controls.map, controls.wireframe, controls.with_body):
            self._on_change(handle, self._draw)
        controls.upload.on_upload(lambda event: self._guarded(self._take_upload, event.target.value))
        self._on_click(controls.to_pattern, self._wear, None)
        self._on_click(controls.refine, self._start_simulation, "refine")
        self._on_click(controls.simulate, self._start_simulation, "dress")
        self._on_click(controls.lower_arms, self._start_simulation, "arms")
        self._on_click(controls.cancel, self._cancel_simulation)
        makers: tuple[tuple[str, Callable[[DressedBody], bytes]], ...] = (
            ("garment.glb", lambda dressed: mesh_file(dressed, ".glb")),
            ("garment.obj", lambda dressed: mesh_file(dressed, ".obj")),
            ("pattern.svg", lambda dressed: pattern_file(dressed, self.model.session.space)),
            ("garment.png", lambda dressed: picture_file(dressed, self._map)),
        )
        for label, (name, make) in zip(DOWNLOADS, makers, strict=True):
            self._on_click(controls.downloads[label], self._download, name, make)

    def _on_change(self, handle: Any, action: Callable[..., None], *arguments: Any) -> None:
        """Act when the visitor moves something; what the program sets itself comes without a client."""
        handle.on_update(lambda event: self._guarded(action, *arguments) if event.client is not None else None)

    def _on_click(self, button: viser.GuiButtonHandle, action: Callable[..., None], *arguments: Any) -> None:
        button.on_click(lambda _: self._guarded(action, *arguments))

    @property
    def _map(self) -> str | None:
        """The map that colours the drape, if one does."""
        return None if self.controls.map.value == PLAIN else self.controls.map.value

    def _changed(self, **changes: Any) -> None:
        """Drape what the controls say now; `changes` are fields of the settings that have no control."""
        controls, space = self.controls, self.model.session.space
        # Sliders go in steps of half a centimetre: the ends of the range may lie between two.
        design = np.clip([slider.value / 100 for slider in controls.design], space.minimum, space.maximum)
        self.settings = replace(
            self.settings,
            design=tuple(float(v) for v in design),
            betas=tuple(float(slider.value) for slider in controls.betas),
            fabric=controls.fabric.value,
            seed=int(controls.seed.value),
            push_out=bool(controls.push_out.value),
            arms=float(controls.arms.value),
            **changes,
        )
        self._asked_at = time.perf_counter()
        self._computing.give(self.settings)

    def _take_design(self) -> None:
        self.controls.preset.value = CUSTOM
        self._changed()

    def _take_preset(self) -> None:
        space, name = self.model.session.space, self.controls.preset.value
        if name == CUSTOM:
            return
        chosen = space.mean_design if name == "mean" else space.preset(name)
        for slider, value in zip(self.controls.design, chosen.values, strict=True):
            slider.value = round(200 * float(value)) / 2
        self._changed()

    def _take_betas(self) -> None:
        self._asked.clear()
        self.controls.fitted.content = ""
        self._changed()

    def _take_measurement(self, name: str) -> None:
        """The nearest body to the measurements that were set since the betas were moved; the others follow."""
        self._asked[name] = float(self.controls.tapes[name].value) / 100
        fit = self.model.session.body_of(self._asked)
        missed = ", ".join(f"{name} {100 * miss:+.1f} cm" for name, miss in fit.residuals.items())
        self.controls.fitted.content = f"nearest body: {missed}"
        reaches = self.model.beta_ranges
        for slider, beta, reach in zip(self.controls.betas, np.asarray(fit.betas), reaches, strict=True):
            slider.value = float(np.clip(beta, -reach, reach))
        self._changed()

    def _take_upload(self, file: viser.UploadedFile) -> None:
        session = self.model.session
        self._wear(read_upload(file.name, file.content, lambda path, name: session.bring(path, label=name)))

    def _wear(self, own: UploadedMesh | None) -> None:
        """Put on a mesh of the visitor's own, or go back to the pattern."""
        if own is not None:
            # What is wrong with a mesh shows when it is prepared: then the page stays as it was.
            self.model.compute(replace(self.settings, own=own))
        controls = self.controls
        for handle in (controls.preset, *controls.design, controls.seed):
            handle.disabled = own is not None
        controls.to_pattern.visible = controls.own.visible = own is not None
        if own is not None:
            controls.own.content = "  \n".join([f"wearing **{own.name}**", *own.remarks])
        self._changed(own=own)

    # Work

    def _guarded(self, action: Callable[..., None], *arguments: Any) -> None:
        """Run `action`; errors of a request are shown in the page."""
        try:
            action(*arguments)
        except (ValueError, TypeError, OSError, ImportError) as error:
            self._say(error)

    def _say(self, error: Exception) -> None:
        self.client.add_notification("That did not work", str(error), color="red", auto_close_seconds=20)

    def _work_on_settings(self, settings: Any) -> None:
        if self.result is None or self.result.settings != settings:
            result = self.model.compute(settings, self.result)
            with self._drawing:
                self._waited = time.perf_counter() - self._asked_at
                self._take_result(result)
            self._finishing.give(result)

    def _work_on_finish(self, result: Result) -> None:
        if result.dressed.garment.near is not None:
            # While a slider moves, the next answer comes before this one needs to be made anew.
            time.sleep(_STILL)
            if self.result is not result:
                return
        finished = self.model.finish(result)
        with self._drawing:
            if self.result is result:
                self._take_result(finished)

    def _take_result(self, result: Result) -> None:
        self.result = result
        layers = tuple(name for name in LAYERS if name in result.layers)
        if self.controls.layer.options != layers:
            self.controls.layer.options = layers
        self._draw()
        self._tell(result)

    def _draw(self) -> None:
        result, controls = self.result, self.controls
        if result is None:
            return
        with self._drawing, self.client.atomic():
            layer = controls.layer.value if controls.layer.value in result.layers else LAYERS[0]
            colors = None
            if self._map is not None and layer == "drape" and result.dressed.fit is not None:
                colors = map_colors(result.dressed.fit, self._map)
            body = result.body(layer)
            self._floor.position = (0.0, float(body.vertices[:, 1].min()), 0.0)
            self._show("body", body, SKIN, None, visible=controls.with_body.value and layer != "panels")
            self._show("garment", result.layers[layer], CLOTH, colors, wireframe=controls.wireframe.value)
            controls.legend.visible = self._map is not None and layer == "drape"
            if self._map is not None:
                controls.legend.content = legend(self._map)

    def _show(
        self,
        name: str,
        mesh: ShownMesh,
        material: Material,
        colors: np.ndarray | None,
        *,
        visible: bool = True,
        wireframe: bool = False,
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        kind = (colors is not None, wireframe)
        scene = self.client.scene
        known, faces, handle = self._shown.get(name, (None, np.zeros((0, 3), int), None))
        if colors is not None and not wireframe:
            part = mesh_part(name, mesh.vertices, mesh.faces, material=material, colors=colors)
            data = through_file(".glb", lambda path: write_glb(path, [part]))
            handle = scene.add_glb(f"/{name}", data, visible=visible, position=position, receive_shadow=False)
        elif handle is not None and known == kind and np.array_equal(faces, mesh.faces):
            handle.vertices = np.asarray(mesh.vertices, np.float32)
            handle.visible = visible
        else:
            handle = scene.add_mesh_simple(
                f"/{name}",
                np.asarray(mesh.vertices, np.float32),
                mesh.faces,
                color=material.color,
                wireframe=wireframe,
                side="double" if material.double_sided else "front",
                visible=visible,
                position=position,
                # Thin cloth would be striped by its own shadow: only the floor shows any.
                receive_shadow=False,
            )
        self._shown[name] = kind, mesh.faces, handle

    def _tell(self, result: Result) -> None:
        controls = self.controls
        for name, slider in controls.tapes.items():
            if name not in self._asked:
                slider.value = round(200 * result.dressed.body.measurements[name]) / 2
        lines = ["measuring …"] if result.dressed.fit is None else result.dressed.fit.lines()
        if result.dressed.pushed is not None:
            before = 100 * result.dressed.pushed.inside_before
            lines.append(f"pushed out: {before:.1f} % of the cloth had been inside")
        if result.dressed.verdict is not None:
            lines += [f"**{line}**" for line in result.dressed.verdict.lines()]
        controls.report.content = "  \n".join(lines)
        times = [f"{name}: {1000 * seconds:.0f} ms" for name, seconds in result.seconds.items()]
        controls.times.content = "  \n".join([*times, f"**slider to drape: {1000 * self._waited:.0f} ms**"])
        controls.command.value = command_line(result.settings, self.model.session.space, self.source)

    def _download(self, name: str, make: Callable[[DressedBody], bytes]) -> None:
        if self.result is not None:
            data = make(self.model.finish(self.result).seen)
            self.client.send_file_download(name, data, save_immediately=True)

    # Simulation

    def _start_simulation(self, kind: Kind) -> None:
        if self.result is None or (self._simulation is not None and self._simulation.running):
            return
        self._enable_simulation(False)
        self.controls.cancel.visible = self.controls.progress.visible = True
        self.controls.progress.value = 0.0
        self.controls.outcome.content = _BEGUN[kind]
        # Step back so that both bodies are seen.
        self.client.camera.position = (_BESIDE / 2, 0.2, 4.6)
        self.client.camera.look_at = (_BESIDE / 2, -0.05, 0.0)
        self._simulation = Simulation(
            self.model.session, self.result, self._simulation_step, self._simulation_end, kind
        )

    def _cancel_simulation(self) -> None:
        if self._simulation is not None:
            # First the word, which the end of the simulation replaces.
            self.controls.outcome.content = "stopping …"
            self._simulation.cancel()

    def _simulation_step(self, share: float, garment: ShownMesh, body: ShownMesh) -> None:
        self.controls.progress.value = 100 * share
        with self._drawing:
            self._show("simulation", garment, _SIMULATED, None, position=(_BESIDE, 0.0, 0.0))
            self._show("simulated body", body, SKIN, None, position=(_BESIDE, 0.0, 0.0))

    def _enable_simulation(self, enabled: bool) -> None:
        for button in (self.controls.refine, self.controls.simulate, self.controls.lower_arms):
            button.disabled = not enabled

    def _simulation_end(self, words: str) -> None:
        self.controls.outcome.content = words
        self._enable_simulation(True)
        self.controls.cancel.visible = self.controls.progress.visible = False
