"""Check the simulator against textile tests, the reference implementation and known mechanics; a record with plots."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from experiments.data.simulator_checks.mechanics import (
    check_convergence,
    check_elastica,
    check_energy,
    check_hysteresis,
    check_incline,
    check_rounding,
)
from experiments.data.simulator_checks.options import Config, Found
from experiments.data.simulator_checks.plots import plot_checks
from experiments.data.simulator_checks.reference import check_forces, check_tube
from experiments.data.simulator_checks.textiles import check_cantilever, check_drape, check_uniaxial
from experiments.shared.record import read_result, write_result
from measuring.records import environment, table
from tryon_jax.checks import check_choice
from tryon_jax.files.atomic import write_text
from tryon_jax.physics.fabrics import fabric_names

NAME = "validate_simulator"
CHECKS: dict[str, Callable[[Config], Found]] = {
    "forces": check_forces,
    "tube": check_tube,
    "uniaxial": check_uniaxial,
    "elastica": check_elastica,
    "cantilever": check_cantilever,
    "drape": check_drape,
    "incline": check_incline,
    "energy": check_energy,
    "convergence": check_convergence,
    "hysteresis": check_hysteresis,
    "rounding": check_rounding,
}


def main(config: Config) -> None:
    """Run the checks; the record and the plots are up to date after each one."""
    names = [check_choice("check", name, CHECKS) for name in config.only] or list(CHECKS)
    for fabric in config.fabrics:
        check_choice("fabric", fabric, fabric_names())
    out = config.out.expanduser()
    results: dict[str, Found] = (read_result(out, NAME) or {"results": {}})["results"]
    for name in names:
        begin = time.process_time()
        found = CHECKS[name](config)
        seconds = round(time.process_time() - begin, 1)
        # A check may be run anew long after the others: each says where and with what.
        results[name] = found | {"processor_seconds": seconds, "environment": environment()}
        results = {key: results[key] for key in CHECKS if key in results}
        write_result(out, NAME, config, results)
        # Included by docs/simulator.md; no page of its own.
        write_text(out / f"{NAME}.txt", as_markdown(results))
        plot_checks(out / f"{NAME}.png", results)
        print(as_markdown({name: found}))


def as_markdown(results: Mapping[str, Mapping[str, Any]]) -> str:
    """The record as text."""
    parts = []
    for name, found in results.items():
        parts += [f"### {name}", found["about"]]
        if found.get("rows"):
            parts.append(table(found["rows"]))
        if found.get("note"):
            parts.append(found["note"])
    return "\n\n".join(parts) + "\n"
