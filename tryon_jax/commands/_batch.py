"""A batch of garments from a CSV file: checked as a whole first, written row by row, continued where it stopped.

Rows of one garment and fabric that are not far apart are draped in one call. The table `fit.csv` has the same columns
whatever the rows hold. A row that fails has its reason there, and the others go on. A row is done again only when it
failed, when its files are gone, or when something else is asked for.
"""

import csv
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tryon_jax.commands._answer import FAILURES, Draped, Treatment, answer, check, drape_together, pictured
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._output import OutputOptions, Target
from tryon_jax.commands._report import record, report_lines
from tryon_jax.commands._request import Request
from tryon_jax.commands._say import say
from tryon_jax.commands._table import FAILED, TABLE, cell, columns, csv_text, flatten
from tryon_jax.files.atomic import write_text
from tryon_jax.physics.dressing import Diverged
from tryon_jax.wear.gate import Refused
from tryon_jax.wear.session import TOGETHER, Session


@dataclass(frozen=True)
class Batch:
    """Requests with the files that they make, in one folder."""

    folder: Path
    requests: Sequence[Request]
    targets: Sequence[Target]
    treatment: Treatment
    output: OutputOptions
    pose: Float[np.ndarray, "J 3"] | None
    options: str
    """Everything else that the results depend on, as text."""

    def check(self, session: Session) -> None:
        """Look at every row before any is draped; raises `ValueError` that names all that cannot be."""
        bad = []
        for number, request in enumerate(self.requests, start=1):
            try:
                check(session, request, self.treatment)
            except (ValueError, OSError) as error:
                bad.append(f"row {number} ({request.name}): {error}")
        if bad:
            raise ValueError(f"{len(bad)} of {len(self.requests)} rows cannot be draped: {'; '.join(bad)}")

    def run(self, session: Session, clock: Clock) -> list[str]:
        """Drape what is not done yet; returns the names of the rows that failed."""
        names = columns(session.space.names)
        done = self._read(names)
        rows: dict[str, dict[str, str]] = {}
        failed = []
        draped: dict[str, Draped] = {}
        for number, (request, target) in enumerate(zip(self.requests, self.targets, strict=True)):
            if self._is_done(done, request, target):
                say(f"-- {request.name}: done before")
                rows[request.name] = done[request.name]
                continue
            say(f"-- {request.name}")
            if request.name not in draped:
                # Rows of the same garment among the next ones are draped with it; drapes kept stay few.
                ahead = slice(number, number + TOGETHER)
                pairs = zip(self.requests[ahead], self.targets[ahead], strict=True)
                waiting = [r for r, t in pairs if r.name not in draped and not self._is_done(done, r, t)]
                draped |= drape_together(session, waiting, self.treatment, clock)
            row = self._row(session, request, target, clock, draped.pop(request.name, None))
            rows[request.name] = {name: cell((row | {"order": self._order(request)}).get(name)) for name in names}
            if row.get("error"):
                failed.append(request.name)
            # Rows of before that are still to come are kept, so that an interrupted run loses nothing.
            self._write(names, [rows.get(r.name) or done.get(r.name) for r in self.requests])
        self._write(names, [rows.get(r.name) for r in self.requests])
        return failed

    def _is_done(self, done: Mapping[str, Mapping[str, str]], request: Request, target: Target) -> bool:
        row = done.get(request.name)
        return (
            row is not None
            and row["order"] == self._order(request)
            and not row["error"]
            and all(path.is_file() for path in target.paths)
        )

    def _row(
        self, session: Session, request: Request, target: Target, clock: Clock, draped: Draped | None
    ) -> dict[str, Any]:
        """Drape one row and write its files; what goes wrong becomes part of the record."""
        try:
            dressed, remarks = answer(session, request, self.treatment, clock, self.pose, draped)
            shown = None if target.picture is None else pictured(session, dressed, self.treatment, clock, self.pose)
            written = target.write(dressed, request.name, self.output, clock, shown=shown)
        except (Refused, Diverged) as error:
            say(f"refused  {error}")
            return {"name": request.name, "outcome": "refused", "error": str(error)}
        except FAILURES as error:
            say(f"failed   {error}")
            return {"name": request.name, "outcome": FAILED, "error": str(error)}
        say(*report_lines(dressed, remarks), *(f"wrote    {path}" for path in written))
        return flatten(record(dressed, request.name))

    def _order(self, request: Request) -> str:
        """A fingerprint of what is asked for."""
        return hashlib.sha256(f"{request!r} {self.options}".encode()).hexdigest()[:12]

    def _read(self, names: Sequence[str]) -> dict[str, dict[str, str]]:
        """Rows of an earlier run, by name; none where the table is another's."""
        path = self.folder / TABLE
        if not path.is_file():
            return {}
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            if list(reader.fieldnames or ()) != list(names):
                return {}
            return {row["name"]: row for row in reader}

    def _write(self, names: Sequence[str], rows: Sequence[Mapping[str, str] | None]) -> None:
        write_text(self.folder / TABLE, csv_text(names, [row for row in rows if row is not None]))
