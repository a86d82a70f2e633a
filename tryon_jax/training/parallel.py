"""Data-parallel training: a copy of the weights on every device, each with its share of a batch's body shapes.

Losses are means over body shapes, so the mean of the devices' losses and gradients is that of the whole batch, and the
run is that of one device up to rounding. Several processes (and machines) work as one: each draws the same batch from
the step's number and keeps what its devices need; the first one alone reads and writes the run's folder.
"""

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from tryon_jax.checks import check_range
from tryon_jax.training.parts import Batch, Params, ValueAndGrad, varies_by_shape

AXIS = "data"
"""Name of the axis of devices."""


@contextmanager
def joined_processes(coordinator: str, processes: int, process: int, heartbeat: int = 100) -> Iterator[None]:
    """Make this process one of several that train together; enter before JAX is used for anything else.

    Whatever ends one process ends them all, each with one line and an exit code that is not 0: otherwise those that are
    left would wait for it for ever. The last checkpoint is kept.

    Args:
        coordinator: host:port at which process 0 can be reached by all others.
        processes: how many there are.
        process: number of this one, from 0.
        heartbeat: seconds without a sign of life after which a process counts as lost, where no connection broke.

    Raises:
        ValueError: the numbers do not fit, or `coordinator` is not host:port.
        RuntimeError: the others did not come within five minutes.
    """
    check_range("processes", processes, 1, 4096)
    check_range("process", process, 0, processes - 1)
    if not coordinator.rpartition(":")[2].isdigit():
        raise ValueError(f"coordinator = {coordinator!r} must be host:port")
    jax.distributed.initialize(coordinator, processes, process, heartbeat_timeout_seconds=heartbeat)
    try:
        yield
    except BaseException as error:
        lost = isinstance(error, jax.errors.JaxRuntimeError)
        reason = "another process was lost; start all of them again to continue" if lost else "ended"
        detail = " ".join(str(error).split())[:300] or type(error).__name__
        print(f"process {process}: {reason} ({detail})", file=sys.stderr, flush=True)
        # Python's own way out would wait for the processes that are gone.
        os._exit(130 if isinstance(error, KeyboardInterrupt) else 1)
    jax.distributed.shutdown()


class SingleDevice:
    """Training on the default device alone."""

    is_main = True
    """True where files are written and progress is shown."""

    def average(self, value_and_grad: ValueAndGrad) -> ValueAndGrad:
        """Loss and gradient of a batch."""
        return value_and_grad

    def replicate(self, tree: Any) -> Any:
        """Weights and optimiser state where they are needed."""
        return tree

    def split(self, batch: Batch) -> Batch:
        """A batch where it is needed."""
        return batch

    def local(self, tree: Any) -> Any:
        """A replicated tree on one device of this process."""
        return tree

    def agree(self, value: Any) -> Any:
        """The first process's plain JSON value, for all."""
        return value

    def agree_arrays(self, tree: Any) -> Any:
        """The first process's arrays, for all."""
        return tree


class DataParallel(SingleDevice):
    """Training on several devices, of one process or of several."""

    def __init__(self, devices: Sequence[Any]) -> None:
        self.mesh = Mesh(np.array(devices), (AXIS,))
        self.is_main = jax.process_index() == 0
        self.shared = any(device.process_index != devices[0].process_index for device in devices)

    def average(self, value_and_grad: ValueAndGrad) -> ValueAndGrad:
        """Mean over the devices of loss and gradient, each of its own part of the batch."""

        def whole(params: Params, batch: Batch) -> tuple[jax.Array, Params]:
            leaves, structure = jax.tree.flatten(batch)

            def part(params: Params, leaves: list[jax.Array]) -> tuple[jax.Array, Params]:
                return jax.lax.pmean(value_and_grad(params, jax.tree.unflatten(structure, leaves)), AXIS)

            # The sparse product is a primitive without a rule for varying axes.
            run = jax.shard_map(part, mesh=self.mesh, in_specs=(P(), partition(batch)), out_specs=P(), check_vma=False)
            return run(params, leaves)

        return whole

    def replicate(self, tree: Any) -> Any:
        """A copy on every device."""
        return jax.tree.map(lambda leaf: self._put(leaf, P()), tree)

    def split(self, batch: Batch) -> Batch:
        """The batch's body shapes over the devices; garments on all of them.

        Raises:
            ValueError: the number of shapes is not a multiple of the number of devices.
        """
        specs, count = partition(batch), self.mesh.size
        leaves, structure = jax.tree.flatten(batch)
        for leaf, spec in zip(leaves, specs, strict=True):
            if spec != P() and leaf.shape[1] % count:
                raise ValueError(
                    f"{leaf.shape[1]} body shapes in a batch cannot be split over {count} devices: "
                    f"use a multiple of {count} shapes, or fewer devices"
                )
        return jax.tree.unflatten(structure, [self._put(leaf, spec) for leaf, spec in zip(leaves, specs, strict=True)])

    def local(self, tree: Any) -> Any:
        """The copy on this process's first device."""
        return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)

    def agree(self, value: Any) -> Any:
        """The first process's plain JSON value, for all; also waits for all."""
        if not self.shared:
            return value
        text = np.frombuffer(json.dumps(value).encode(), np.uint8)
        size = int(multihost_utils.broadcast_one_to_all(np.int32(len(text))))
        padded = np.zeros(size, np.uint8)
        padded[: min(size, len(text))] = text[:size]
        return json.loads(np.asarray(multihost_utils.broadcast_one_to_all(padded)).tobytes())

    def agree_arrays(self, tree: Any) -> Any:
        """The first process's arrays, for all."""
        return multihost_utils.broadcast_one_to_all(jax.tree.map(np.asarray, tree)) if self.shared else tree

    def _put(self, leaf: Any, spec: P) -> jax.Array:
        array = np.asarray(leaf)
        return jax.make_array_from_callback(array.shape, NamedSharding(self.mesh, spec), lambda part: array[part])


def visible_devices() -> SingleDevice:
    """All devices that JAX sees, of all processes that have joined: one is used by itself, several in parallel."""
    devices = jax.devices()
    return SingleDevice() if len(devices) == 1 else DataParallel(devices)


def partition(batch: Batch) -> list[P]:
    """How each leaf of a batch is cut: what varies by body shape along axis 1."""
    return [P(None, AXIS) if varies else P() for varies in varies_by_shape(batch)]
