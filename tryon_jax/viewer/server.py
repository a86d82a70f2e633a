"""The server behind the pages: one page for each visitor, on the loopback address unless told otherwise."""

import numpy as np
import viser

from tryon_jax.tryon import TryOnModel
from tryon_jax.viewer.page import Page
from tryon_jax.viewer.wardrobe import Wardrobe


def serve(model: TryOnModel, *, host: str = "127.0.0.1", port: int = 8080) -> viser.ViserServer:
    """Start the try-on in a browser and return the server, which runs in threads of its own until `stop()`.

    Args:
        model: drapes what is asked for.
        host: address to listen on; everybody who reaches it can use the page.
        port: where to listen; the next free one is taken when it is in use.
    """
    wardrobe = Wardrobe(model)
    # Compiles everything before the first visitor waits for it.
    wardrobe.look(wardrobe.start())
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
        pages[client.client_id] = Page(client, wardrobe)

    @server.on_client_disconnect
    def _(client: viser.ClientHandle) -> None:
        page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    return server
