"""The panel of one page: folders, sliders and buttons, without what they do."""

from viser import GuiApi

from tryon_jax.body.stance import LOWEST
from tryon_jax.render.fit_maps import MAPS
from tryon_jax.viewer.page_model import LAYERS, PageModel

TAPES = ("stature", "chest", "waist", "hip")
"""Measurements that have sliders."""
CUSTOM = "custom"
"""What the list of presets says when a slider was moved by hand."""
PLAIN = "plain"
"""What the list of colours says when there is no map."""
DOWNLOADS = ("GLB", "OBJ", "pattern (SVG, true size)", "picture")
"""Labels of the buttons that give files."""


class Controls:
    """Handles of everything that a visitor can move, press or read."""

    def __init__(self, gui: GuiApi, model: PageModel) -> None:
        gui.set_panel_label("tryon_jax")
        self._add_garment(gui, model)
        self._add_body(gui, model)
        self._add_view(gui)
        self._add_simulation(gui)
        with gui.add_folder("Take away", expand_by_default=False):
            self.downloads = {label: gui.add_button(label) for label in DOWNLOADS}
            self.command = gui.add_text("command", "", multiline=True, hint="Makes the same in a terminal.")

    def _add_garment(self, gui: GuiApi, model: PageModel) -> None:
        space, start = model.session.space, model.start()
        with gui.add_folder("Garment"):
            presets = ("mean", *space.presets, CUSTOM)
            named = {name: tuple(float(v) for v in space.preset(name).values) for name in space.presets}
            name = next((name for name, values in named.items() if values == start.design), "mean")
            self.preset = gui.add_dropdown("preset", presets, initial_value=name)
            self.design = [
                gui.add_slider(
                    f"{name.replace('_', ' ')}, cm",
                    min=round(100 * float(space.minimum[i]), 1),
                    max=round(100 * float(space.maximum[i]), 1),
                    step=0.5,
                    initial_value=round(200 * start.design[i]) / 2,
                )
                for i, name in enumerate(space.names)
            ]
            fabrics = model.session.fabrics
            self.fabric = gui.add_dropdown("fabric", fabrics, initial_value=start.fabric)
            self.seed = gui.add_number(
                "mesh number", 0, min=0, max=999, step=1, hint="Another number gives another mesh of the same garment."
            )
            self.push_out = gui.add_checkbox("push out of the body", start.push_out)
            self.upload = gui.add_upload_button(
                "your own mesh …",
                mime_type=".obj,.glb,.ply",
                hint="A garment as it hangs on the mean body in T-pose: OBJ, GLB or PLY.",
            )
            self.to_pattern = gui.add_button("back to the pattern", visible=False)
            self.own = gui.add_markdown("", visible=False)

    def _add_body(self, gui: GuiApi, model: PageModel) -> None:
        with gui.add_folder("Body"):
            if model.dresses_another_body:
                gui.add_markdown(
                    f"**{model.session.body.name}**: draped on the nearest shape of the networks' body and carried "
                    "over; an approximation."
                )
            self.betas = [
                gui.add_slider(f"beta {i + 1}", min=-reach, max=reach, step=0.05, initial_value=0.0)
                for i, reach in enumerate(model.beta_ranges)
            ]
            self.tapes = {}
            for name, (low, high) in model.tape_ranges(TAPES).items():
                low, high = round(100 * low), round(100 * high)
                middle = (low + high) / 2
                self.tapes[name] = gui.add_slider(f"{name}, cm", min=low, max=high, step=0.5, initial_value=middle)
            self.fitted = gui.add_markdown("")
            self.arms = gui.add_slider(
                "arms down, degrees",
                min=0.0,
                max=LOWEST,
                step=1.0,
                initial_value=model.start().arms,
                visible=model.lowers_arms,
                hint="The fit is measured in T-pose.",
            )

    def _add_view(self, gui: GuiApi) -> None:
        with gui.add_folder("Show"):
            self.layer = gui.add_dropdown("layer", LAYERS, initial_value=LAYERS[0])
            self.map = gui.add_dropdown(
                "colour", (PLAIN, *MAPS), initial_value=PLAIN, hint="Maps are measured on the drape."
            )
            self.legend = gui.add_html("", visible=False)
            self.wireframe = gui.add_checkbox("wireframe", False)
            self.with_body = gui.add_checkbox("body", True)
        with gui.add_folder("Fit"):
            self.report = gui.add_markdown("…")
        with gui.add_folder("Time"):
            self.times = gui.add_markdown("…")

    def _add_simulation(self, gui: GuiApi) -> None:
        with gui.add_folder("Compare with a simulation", expand_by_default=False):
            self.refine = gui.add_button("refine this drape", hint="Brings the learned drape to rest by simulation.")
            self.simulate = gui.add_button("simulate this garment", hint="Dresses it anew, without the networks.")
            self.lower_arms = gui.add_button("lower the arms", hint="The drape follows by simulation.")
            self.cancel = gui.add_button("cancel", visible=False)
            self.progress = gui.add_progress_bar(0.0, visible=False)
            self.outcome = gui.add_markdown("")
