"""Open the try-on in a browser: sliders for design, body and fabric, and the drape that follows them.

tryon view --port 8080
"""

from dataclasses import dataclass
from pathlib import Path

from tryon_jax.tryon import load_model, load_pretrained


@dataclass(frozen=True)
class Config:
    """Options of `tryon view`."""

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
    except ImportError as error:
        raise ImportError(f"the viewer needs viser: pip install 'tryon_jax[viewer]' ({error})") from error
    model = load_pretrained() if config.weights is None else load_model(config.weights)
    print("getting ready …", flush=True)
    server = serve(model, host=config.host, port=config.port)
    print(f"open http://{config.host}:{server.get_port()} in a browser; Ctrl+C ends", flush=True)
    server.sleep_forever()
