"""Open the try-on in a browser: sliders for design, body and fabric, and the drape that follows them.

tryon view
tryon view --garment my_dress.obj
tryon view --smpl SMPL_FEMALE.npz --port 8081
"""

from dataclasses import dataclass, field
from pathlib import Path

from tryon_jax.body import load_smpl
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.own import OwnOptions, bring_own


@dataclass(frozen=True)
class Config:
    """Options of `tryon view`."""

    garment: Path | None = None
    """Mesh of your own garment to begin with: .obj, .glb, .gltf or .ply, its place on the body is found."""
    own: OwnOptions = field(default_factory=OwnOptions)
    smpl: Path | None = None
    """File of SMPL, SMPL-H or SMPL-X (.npz or .pkl) to dress in place of the networks' body: an approximation."""
    host: str = "127.0.0.1"
    """Address to listen on. The default can be reached from this computer only."""
    port: int = 8080
    """Port to listen on; the next free one when it is in use."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""


def main(config: Config) -> None:
    """Serve until interrupted."""
    try:
        from tryon_jax.viewer import serve
        from tryon_jax.viewer.page_model import UploadedMesh
    except ImportError as error:
        raise ImportError(f"the viewer needs viser: pip install 'tryon_jax[viewer]' ({error})") from error
    own_body = None if config.smpl is None else load_smpl(config.smpl)
    model = load_pretrained() if config.weights is None else load_model(config.weights)
    own = None
    if config.garment is not None:
        own = UploadedMesh(str(config.garment), bring_own(config.garment, model.body, config.own))
    named = {"--smpl": config.smpl, "--weights": config.weights}
    source = tuple(word for option, path in named.items() if path is not None for word in (option, str(path)))
    print("getting ready …", flush=True)
    server = serve(model, host=config.host, port=config.port, own=own, own_body=own_body, source=source)
    print(f"open http://{config.host}:{server.get_port()} in a browser; Ctrl+C ends", flush=True)
    server.sleep_forever()
