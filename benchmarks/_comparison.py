"""A comparison under way: its record, which is written after every cell, and what of it is still to be measured."""

import json
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

from benchmarks._machine import Ceilings, measure_ceilings, surroundings
from benchmarks._pieces import LIMITS, RUNNING, cut_off, failed, measured, read_begun
from benchmarks._subjects import Cell
from measuring.records import plain
from tryon_jax.files.atomic import write_text


class Comparison:
    """Cells of one device, measured in as many pieces as it takes."""

    def __init__(
        self,
        path: Path,
        options: dict[str, Any],
        cells: Sequence[Cell],
        minutes: float,
        resume: bool,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin a record, or go on with that at `path`.

        Args:
            path: Of the record.
            options: That its numbers depend on (see `_pieces.FREE` for those that may differ from piece to piece).
            cells: In the order in which they are measured.
            minutes: Time for this piece, which the record names where it did not suffice.
            resume: Go on with a record that is there.
            clock: Seconds.

        Raises:
            ValueError: the record was begun with other hardware, versions or options.
        """
        self.path, self.minutes, self.clock = path, minutes, clock
        self.began = clock()
        self._options = options | {"out": ""}
        before = surroundings()
        record = read_begun(path, self._options, before) if resume else None
        self.piece: dict[str, Any] = {name: before[name] for name in ("date", "load_average", "clocks_mhz")}
        self.record: dict[str, Any] = record or {
            "benchmark": "compare",
            "environment": before,
            "minutes": 0.0,
            "config": self._options,
            "versions_of_peers": peer_versions(),
            "pieces": [],
            "cells": [],
        }
        self.failures: list[str] = []
        self._minutes_before = self.record["minutes"]
        entries = self.record["cells"]
        earlier = {Cell(**{f.name: entry[f.name] for f in fields(Cell)}): entry for entry in entries}
        self.record["cells"] = [earlier.get(cell, asdict(cell) | cut_off(minutes)) for cell in cells]
        self._at = {cell: k for k, cell in enumerate(cells)}

    def measure_ceilings(self, size: int, megabytes: int) -> Ceilings:
        """What the device reaches in its two simplest tasks, for this piece; those of the first head the record."""
        found = measure_ceilings(size, megabytes)
        self.piece["ceilings"] = {
            "dense_gflops": found.dense,
            "bandwidth_gb_s": found.bandwidth,
            "bandwidth_gb_s_by_mb": found.by_megabytes,
        }
        self.record.setdefault("ceilings", self.piece["ceilings"])
        return found

    def entry(self, cell: Cell) -> dict[str, Any]:
        """What the record says of a cell."""
        return self.record["cells"][self._at[cell]]

    def open_cells(self, cells: Sequence[Cell]) -> list[Cell]:
        """Those that are to be measured; last the ones during which a run ended, lest they end this one too."""
        still = [cell for cell in cells if not measured(self.entry(cell), self._options)]
        return sorted(still, key=lambda cell: self.entry(cell)["skipped"] == RUNNING)

    def measure(
        self,
        cells: Sequence[Cell],
        measure: Callable[[Cell], dict[str, Any]],
        until: float,
        must_fit: bool = False,
        title: str = "cells",
    ) -> None:
        """Measure what is open of `cells`; nothing is begun after `until`, a time of the clock.

        With `must_fit`, nothing either that takes longer than is left, as told by the longest cell of its kind so
        far, or by what is usual where there is none.
        """
        still = self.open_cells(cells)
        if still and self.piece not in self.record.setdefault("pieces", []):
            self.record["pieces"].append(self.piece)
            self.record["config"] |= {name: self._options[name] for name in LIMITS}
        for cell in tqdm(still, desc=title, mininterval=2, disable=not still):
            now = self.clock()
            if now > until or (must_fit and now + self._likely_seconds(cell) > until):
                if self.entry(cell)["skipped"] != RUNNING:
                    self.settle(cell, asdict(cell) | cut_off(self.minutes))
                continue
            self.settle(cell, asdict(cell) | {"skipped": RUNNING})
            try:
                entry = measure(cell)
            except (ValueError, RuntimeError) as error:
                # One cell that is wrong, or out of memory, must not cost the others; the command fails at its end.
                entry = asdict(cell) | failed(error)
                self.failures.append(f"{cell}: {error}")
            self.settle(cell, entry | {"took_s": round(self.clock() - now, 2)})

    def settle(self, cell: Cell, entry: dict[str, Any]) -> None:
        """Put an entry into the record and write it."""
        self.record["cells"][self._at[cell]] = entry
        self.write()

    def write(self) -> None:
        """Write the record with the time taken so far."""
        self.piece["minutes"] = round((self.clock() - self.began) / 60, 2)
        load = [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else []
        self.piece["load_average_after"] = self.record["load_average_after"] = load
        self.record["minutes"] = round(self._minutes_before + self.piece["minutes"], 2)
        stats = jax.devices()[0].memory_stats() or {}
        self.record["device_peak_mb"] = stats.get("peak_bytes_in_use", 0) / 1e6 or None
        write_text(self.path, json.dumps(self.record, indent=1, default=plain) + "\n")

    def raise_failures(self) -> None:
        """Raise what went wrong in single cells, after all others.

        Raises:
            RuntimeError: something did.
        """
        if self.failures:
            raise RuntimeError(f"{len(self.failures)} cells failed, the first: {self.failures[0]}")

    def _likely_seconds(self, cell: Cell) -> float:
        timed = [entry for entry in self.record["cells"] if "took_s" in entry]
        alike = [e["took_s"] for e in timed if (e["subject"], e["config"]) == (cell.subject, cell.config)]
        return max(alike) if alike else statistics.median([e["took_s"] for e in timed] or [0.0])


def peer_versions() -> dict[str, str]:
    """Versions of the peers that are installed."""
    import importlib.metadata

    found = {}
    for name in ("torch", "torch_geometric", "scipy"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
