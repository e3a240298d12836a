"""Batches on every core of the machine."""

import os

import jax
from jax.sharding import AxisType, PartitionSpec


def use_all_cores() -> None:
    """One JAX device per core, and float64; before the first array is created."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


def on_all_cores(function):
    """Compiled, over equal shares of the leading axis, one for each core."""
    mesh = jax.make_mesh((jax.device_count(),), ("cores",), axis_types=(AxisType.Auto,))
    spec = PartitionSpec("cores")
    return jax.jit(
        jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    )
