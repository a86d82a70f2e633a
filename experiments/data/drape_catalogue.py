"""Drape a catalogue, random garments x random bodies, on many processes or machines; resumable at any moment."""

import os
import time
from dataclasses import dataclass, field
from pathlib import Path

from experiments.shared.pool import checksums, open_pool, run_all
from tryon_jax.checks import check_range
from tryon_jax.commands._catalogue import CatalogueConfig, drape_block, open_catalogue
from tryon_jax.files.atomic import write_text


@dataclass(frozen=True)
class Config:
    """What to drape, and where; running again continues where it stopped."""

    out: Path = Path("catalogue")
    """Folder of the drapes."""
    catalogue: CatalogueConfig = field(default_factory=CatalogueConfig)
    processes: int = os.cpu_count() or 1
    """Worker processes, one core each."""
    scheduler: str = ""
    """Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work instead (extra `distributed`);
    they must see the folder and the model at the same paths."""


def main(config: Config) -> None:
    """Drape all blocks whose files are missing, and write checksums.txt."""
    check_range("processes", config.processes, 1, 1024)
    root = config.out.expanduser().resolve()
    missing = open_catalogue(root, config.catalogue)
    blocks = config.catalogue.garments * -(-config.catalogue.bodies // config.catalogue.block)
    began = time.monotonic()
    with open_pool(config.processes, config.scheduler) as pool:
        failed = run_all(pool, "drapes", drape_block, missing, blocks - len(missing))
    seconds = time.monotonic() - began
    write_text(root / "checksums.txt", checksums(root))
    drapes = (len(missing) - len(failed)) * config.catalogue.block
    print(f"about {drapes} drapes in {seconds:.1f} s, start of the workers and compilation included")
    if failed:
        raise RuntimeError(f"{len(failed)} blocks failed, the first: {failed[0]}")
