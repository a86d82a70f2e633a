"""One visitor's page: controls, the scene, and a worker that always computes the latest wish."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from tryon_jax.export import CLOTH, SKIN, Material, mesh_part, write_glb
from tryon_jax.viewer.simulation import Simulation
from tryon_jax.viewer.takeaway import (
    MAPS,
    command_line,
    map_colors,
    mesh_file,
    pattern_file,
    picture_file,
    through_file,
)
from tryon_jax.viewer.wardrobe import LAYERS, Look, Surface, Wardrobe, Wish

BETA_RANGE = 3.0
"""Standard deviations to either side of the mean that the sliders offer."""
TAPES = ("stature", "chest", "waist", "hip")
"""Measurements that have sliders."""
_BESIDE = 1.9


class Page:
    """Controls and scene of one client of the server."""

    def __init__(self, client: viser.ClientHandle, wardrobe: Wardrobe) -> None:
        self.client = client
        self.wardrobe = wardrobe
        self.wish = wardrobe.start()
        self.look: Look | None = None
        self._news = threading.Event()
        self._closed = False
        self._shown: dict[str, tuple[np.ndarray, Any]] = {}
        self._simulation: Simulation | None = None
        # Measurements that the visitor has set, metres.
        self._asked: dict[str, float] = {}
        self._set_scene()
        self._add_controls()
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()
        self._news.set()

    def close(self) -> None:
        """Stop the worker and a simulation that runs; the visitor has gone."""
        self._closed = True
        self._news.set()
        if self._simulation is not None:
            self._simulation.cancel()

    # Controls

    def _set_scene(self) -> None:
        scene = self.client.scene
        # Lamps instead of a photographed surrounding, which the page would have to fetch from elsewhere.
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(190, 185, 180), intensity=1.6)
        scene.add_light_directional("/key", intensity=1.9, position=(-2.0, 2.5, 2.5))

    def _add_controls(self) -> None:
        gui, space, model = self.client.gui, self.wardrobe.space, self.wardrobe.model
        gui.set_panel_label("tryon_jax")
        with gui.add_folder("Garment"):
            self.preset = gui.add_dropdown("preset", ("mean", *space.presets), initial_value="mean")
            self.design = []
            for i, name in enumerate(space.names):
                slider = gui.add_slider(
                    f"{name.replace('_', ' ')}, cm",
                    min=round(100 * float(space.minimum[i]), 1),
                    max=round(100 * float(space.maximum[i]), 1),
                    step=0.5,
                    initial_value=round(100 * float(space.mean[i]), 1),
                )
                self.design.append(slider)
            self.fabric = gui.add_dropdown("fabric", model.config.fabrics, initial_value=model.config.fabrics[0])
            self.seed = gui.add_number("mesh number", 0, min=0, max=999, step=1)
        with gui.add_folder("Body"):
            self.betas = [
                gui.add_slider(f"beta {i + 1}", min=-BETA_RANGE, max=BETA_RANGE, step=0.05, initial_value=0.0)
                for i in range(model.config.num_betas)
            ]
            self.tapes = {}
            for name, (low, high) in self.wardrobe.tape_ranges(TAPES).items():
                low, high = round(100 * low), round(100 * high)
                middle = (low + high) / 2
                self.tapes[name] = gui.add_slider(f"{name}, cm", min=low, max=high, step=0.5, initial_value=middle)
            self.fitted = gui.add_markdown("")
        with gui.add_folder("Show"):
            self.layer = gui.add_dropdown("layer", LAYERS, initial_value=LAYERS[0])
            self.map = gui.add_dropdown("colour", ("plain", *MAPS), initial_value="plain")
            self.wireframe = gui.add_checkbox("wireframe", False)
            self.with_body = gui.add_checkbox("body", True)
        with gui.add_folder("Fit"):
            self.report = gui.add_markdown("…")
        with gui.add_folder("Compare with a simulation", expand_by_default=False):
            self.simulate = gui.add_button("simulate this garment")
            self.cancel = gui.add_button("cancel", visible=False)
            self.progress = gui.add_progress_bar(0.0, visible=False)
            self.outcome = gui.add_markdown("")
        with gui.add_folder("Take away", expand_by_default=False):
            files = {
                "GLB": ("garment.glb", lambda look: mesh_file(look, ".glb")),
                "OBJ": ("garment.obj", lambda look: mesh_file(look, ".obj")),
                "pattern (SVG, true size)": ("pattern.svg", lambda look: pattern_file(look, space)),
                "picture": ("garment.png", picture_file),
            }
            for label, (name, make) in files.items():
                self._on_click(gui.add_button(label), self._download, name, make)
            self.command = gui.add_text("command", "", multiline=True, disabled=True)
        self._listen()

    def _listen(self) -> None:
        for handle in (*self.design, self.fabric, self.seed):
            self._on_change(handle, self._changed)
        for handle in self.betas:
            self._on_change(handle, self._take_betas)
        for name, handle in self.tapes.items():
            self._on_change(handle, self._take_measurement, name)
        self._on_change(self.preset, self._take_preset)
        for handle in (self.layer, self.map, self.wireframe, self.with_body):
            self._on_change(handle, self._news.set)
        self._on_click(self.simulate, self._start_simulation)
        self._on_click(self.cancel, self._cancel_simulation)

    def _on_change(self, handle: Any, action: Callable[..., None], *arguments: Any) -> None:
        """Act when the visitor moves something; what the program sets itself comes without a client."""
        handle.on_update(lambda event: self._guarded(action, *arguments) if event.client is not None else None)

    def _on_click(self, button: viser.GuiButtonHandle, action: Callable[..., None], *arguments: Any) -> None:
        button.on_click(lambda _: self._guarded(action, *arguments))

    def _changed(self) -> None:
        space = self.wardrobe.space
        # Sliders go in steps of half a centimetre: the ends of the range may lie between two.
        design = np.clip([slider.value / 100 for slider in self.design], space.minimum, space.maximum)
        self.wish = Wish(
            tuple(float(v) for v in design),
            tuple(float(slider.value) for slider in self.betas),
            self.fabric.value,
            int(self.seed.value),
        )
        self._news.set()

    def _take_preset(self) -> None:
        space = self.wardrobe.space
        name = self.preset.value
        chosen = space.mean_design if name == "mean" else space.preset(name)
        for slider, value in zip(self.design, chosen.values, strict=True):
            slider.value = round(200 * float(value)) / 2
        self._changed()

    def _take_betas(self) -> None:
        self._asked.clear()
        self.fitted.content = ""
        self._changed()

    def _take_measurement(self, name: str) -> None:
        """The nearest body to the measurements that were set since the betas were moved; the others follow."""
        self._asked[name] = float(self.tapes[name].value) / 100
        fit = self.wardrobe.body_of(self._asked)
        missed = ", ".join(f"{name} {100 * miss:+.1f} cm" for name, miss in fit.residuals.items())
        self.fitted.content = f"nearest body: {missed}"
        for slider, beta in zip(self.betas, np.asarray(fit.betas), strict=True):
            slider.value = float(np.clip(beta, -BETA_RANGE, BETA_RANGE))
        self._changed()

    # Work

    def _guarded(self, action: Callable[..., None], *arguments: Any) -> None:
        """Run `action`; what is wrong with a request is said in the page."""
        try:
            action(*arguments)
        except (ValueError, TypeError, OSError, ImportError) as error:
            self.client.add_notification("That did not work", str(error), color="red", auto_close_seconds=10)

    def _work(self) -> None:
        while not self._closed:
            self._news.wait()
            self._news.clear()
            if not self._closed:
                self._guarded(self._update)

    def _update(self) -> None:
        start = time.perf_counter()
        wish = self.wish
        if self.look is None or self.look.wish != wish:
            self.look = self.wardrobe.look(wish)
        look = self.look
        with self.client.atomic():
            self._show("body", look.body, SKIN, None, visible=self.with_body.value)
            layer = self.layer.value
            colors = map_colors(look, self.map.value) if self.map.value != "plain" and layer == "drape" else None
            self._show("garment", look.layers[layer], CLOTH, colors)
        self._tell(look, time.perf_counter() - start)

    def _show(
        self, name: str, surface: Surface, material: Material, colors: np.ndarray | None, *, visible: bool = True
    ) -> None:
        wire = self.wireframe.value and name == "garment"
        kind = ("colors" if colors is not None else "plain", wire, len(surface.vertices))
        known = self._shown.get(name)
        scene = self.client.scene
        if colors is not None:
            part = mesh_part(name, surface.vertices, surface.faces, material=material, colors=colors)
            data = through_file(".glb", lambda path: write_glb(path, [part]))
            self._shown[name] = surface.faces, (kind, scene.add_glb(f"/{name}", data, visible=visible))
        elif known is not None and known[1][0] == kind and np.array_equal(known[0], surface.faces):
            handle = known[1][1]
            handle.vertices = np.asarray(surface.vertices, np.float32)
            handle.visible = visible
        else:
            handle = scene.add_mesh_simple(
                f"/{name}",
                surface.vertices,
                surface.faces,
                color=material.color,
                wireframe=wire,
                side="double" if material.double_sided else "front",
                visible=visible,
            )
            self._shown[name] = surface.faces, (kind, handle)

    def _tell(self, look: Look, total: float) -> None:
        stages = "  \n".join(f"{name}: {1000 * seconds:.0f} ms" for name, seconds in look.seconds.items())
        fit = "  \n".join(look.fit.lines())
        scale = MAPS.get(self.map.value)
        legend = "" if scale is None else f"\n\ncolour: {scale.label}, {scale.low:g} to {scale.high:g}"
        for name, slider in self.tapes.items():
            if name not in self._asked:
                slider.value = round(200 * look.measured[name]) / 2
        self.report.content = f"{fit}{legend}\n\n{stages}  \nall: {1000 * total:.0f} ms"
        self.command.value = command_line(look.wish, self.wardrobe.space)

    def _download(self, name: str, make: Callable[[Look], bytes]) -> None:
        if self.look is not None:
            self.client.send_file_download(name, make(self.look), save_immediately=True)

    # Simulation

    def _start_simulation(self) -> None:
        if self.look is None or (self._simulation is not None and self._simulation.running):
            return
        self.simulate.disabled = True
        self.cancel.visible = self.progress.visible = True
        self.outcome.content = "dressing the mean body …"
        self._simulation = Simulation(self.wardrobe.model.body, self.look, self._simulation_step, self._simulation_end)

    def _cancel_simulation(self) -> None:
        if self._simulation is not None:
            self._simulation.cancel()
            self.outcome.content = "stopping …"

    def _simulation_step(self, share: float, surface: Surface) -> None:
        self.progress.value = 100 * share
        self.client.scene.add_mesh_simple(
            "/simulation",
            surface.vertices,
            surface.faces,
            color=(176, 112, 88),
            side="double",
            position=(_BESIDE, 0.0, 0.0),
        )

    def _simulation_end(self, words: str) -> None:
        self.outcome.content = words
        self.simulate.disabled = False
        self.cancel.visible = self.progress.visible = False
