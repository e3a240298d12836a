"""Batches on every core of the machine, by `stepax.over_devices`."""

import os

import jax


def use_all_cores() -> None:
    """One JAX device per core, and float64; before the first array is created."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
