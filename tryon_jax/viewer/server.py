"""The server behind the pages: one page for each visitor, on the loopback address unless told otherwise."""

import numpy as np
import viser

from tryon_jax.tryon import TryOnModel
from tryon_jax.types import Body
from tryon_jax.viewer.page import Page
from tryon_jax.viewer.page_model import PageModel, Settings, UploadedMesh


def serve(
    model: TryOnModel,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    own: UploadedMesh | None = None,
    own_body: Body | None = None,
    source: tuple[str, ...] = (),
) -> viser.ViserServer:
    """Start the try-on in a browser and return the server, which runs in threads of its own until `stop()`.

    Args:
        model: drapes what is asked for.
        host: address to listen on; everybody who reaches it can use the page.
        port: where to listen; the next free one is taken when it is in use.
        own: a garment's mesh that pages begin with, in place of a design.
        own_body: a body to dress in place of the networks' one, see `tryon_jax.wear.other_body`.
        source: options that model and body were named by, for the command line that the page shows.

    Raises:
        ValueError: `own` is not on the mean body, or `own_body` cannot be dressed.
    """
    page_model = PageModel(model, own_body)
    start = page_model.start()
    # Compiles everything before the first visitor waits for it.
    first = page_model.finish(page_model.compute(start))
    page_model.session.body_of({"stature": first.dressed.body.measurements["stature"]})
    if own is not None:
        page_model.compute(Settings(start.design, start.betas, start.fabric, own=own))
    server = viser.ViserServer(host=host, port=port, verbose=False)
    server.gui.configure_theme(control_width="large", show_logo=False)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+y")
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = (0.0, 0.2, 3.2), (0.0, -0.05, 0.0), (0.0, 1.0, 0.0)
    camera.fov = np.radians(40.0)
    pages: dict[int, Page] = {}

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        pages[client.client_id] = Page(client, page_model, own=own, source=source)

    @server.on_client_disconnect
    def _(client: viser.ClientHandle) -> None:
        page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    return server
