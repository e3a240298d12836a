"""What a batch of calls does instead of the same call many times: groups, and queues."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.sharding import AxisType, PartitionSpec
from jaxtyping import Array


GROUP = 1024
"""Lanes that a fit works on together on a CPU: what it computes beside them stays small.

Half as many leave the queue of the solver waiting for its last lanes too often; see
`experiments/benchmarks/methods.py`."""

Batch = Callable[[list[Array], tuple[bool, ...], int], Any]
"""Results of a batch, lanes first, from arrays, which of them have lanes, and their number."""


def with_batch(alone: Callable[[list[Array]], Any], together: Batch) -> Callable[..., Any]:
    """`alone`, a function of arrays, which under `jax.vmap` is `together`.

    Nested `vmap`s are one batch of all their lanes. It has no derivatives.
    """
    call = custom_vmap(alone)

    @call.def_vmap
    def rule(size: int, batched: Sequence[list[bool]], leaves: list[Array]):
        return _lanes_first(_merging(together, tuple(batched[0]), size)(leaves))

    return call


def axes_of(batched: tuple[bool, ...]) -> list[int | None]:
    """Axes for `jax.vmap`."""
    return [0 if lanes else None for lanes in batched]


def _lanes_first(results: Any) -> tuple[Any, Any]:
    return results, jax.tree.map(lambda _: True, results)


def _merging(together: Batch, batched: tuple[bool, ...], size: int) -> Callable[..., Any]:
    """`together` as a function of arrays, which a further `vmap` makes a longer batch."""
    call = custom_vmap(lambda leaves: together(leaves, batched, size))

    @call.def_vmap
    def rule(more: int, outer: Sequence[list[bool]], leaves: list[Array]):
        def merged(x: Array, inner: bool, outer: bool) -> Array:
            if not (inner or outer):
                return x
            x = x if outer else x[None]
            x = x if inner else x[:, None]
            x = jnp.broadcast_to(x, (more, size, *x.shape[2:]))
            return x.reshape(more * size, *x.shape[2:])

        leaves = [merged(*each) for each in zip(leaves, batched, outer[0], strict=True)]
        either = tuple(a or b for a, b in zip(batched, outer[0], strict=True))
        found = _merging(together, either, more * size)(leaves)
        return _lanes_first(jax.tree.map(lambda x: x.reshape(more, size, *x.shape[1:]), found))

    return call


def in_groups(function: Callable[..., Any], most: int = GROUP) -> Callable[..., Any]:
    """`function`, which works through a batch group by group, each of `most` lanes at most.

    So memory does not grow with all that is computed on the way. Differentiated, it is `function`
    itself: then a batch is one.
    """

    def grouped(*args: Any, **kwargs: Any) -> Any:
        arrays, static = eqx.partition((args, kwargs), eqx.is_array)
        leaves, form = jax.tree.flatten(arrays)
        rest = []

        def alone(leaves: list[Array]) -> Any:
            args, kwargs = eqx.combine(jax.tree.unflatten(form, leaves), static)
            arrays, other = eqx.partition(function(*args, **kwargs), eqx.is_array)
            rest.append(other)
            return arrays

        def together(leaves: list[Array], batched: tuple[bool, ...], size: int) -> Any:
            return _group_by_group(alone, leaves, batched, size, most)

        def derivative(primals: Any, tangents: Any) -> Any:
            found, moves = eqx.filter_jvp(alone, primals, tangents)
            return _in_every_lane(found, primals), moves

        call = eqx.filter_custom_jvp(with_batch(alone, together))
        call.def_jvp(derivative)
        return eqx.combine(call(leaves), rest[-1])

    return grouped


def _in_every_lane(results: Any, arguments: Any) -> Any:
    """Results as they are, each with the lanes of the arguments, on which it need not depend.

    A rule for derivatives must give what the function gives, in which all results have lanes.
    """
    one = [jnp.ravel(x)[0] for x in jax.tree.leaves(arguments) if x.size]
    lanes = jnp.all(jnp.stack([x == x for x in one]))
    return jax.tree.map(lambda x: jnp.where(lanes, x, x), results)


def _group_by_group(
    alone: Callable[[list[Array]], Any],
    leaves: list[Array],
    batched: tuple[bool, ...],
    size: int,
    most: int,
) -> Any:
    each = jax.vmap(alone, in_axes=(axes_of(batched),))
    # a GPU is fast on many lanes at once
    if size <= most or jax.default_backend() != "cpu":
        return each(leaves)
    groups = -(-size // most)
    length = -(-size // groups)

    def group(number: Array) -> Any:
        lanes = jnp.minimum(number * length + jnp.arange(length), size - 1)
        return each([x[lanes] if own else x for x, own in zip(leaves, batched, strict=True)])

    found = jax.lax.map(group, jnp.arange(groups))
    return jax.tree.map(lambda x: x.reshape(groups * length, *x.shape[2:])[:size], found)


def over_devices(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` of a batch, compiled, with an equal share of the lanes on every JAX device.

    `function` takes and gives arrays, or PyTrees of them, with lanes first, such as
    `jax.vmap(lambda y: identify(StepRecord(t, y), "sopdt_fit").model)`. One device a core of a CPU:
    `jax.config.update("jax_num_cpu_devices", 2)` before the first array is created.
    """
    count = jax.device_count()
    if count == 1:
        return jax.jit(function)
    mesh = jax.make_mesh((count,), ("devices",), axis_types=(AxisType.Auto,))
    spec = PartitionSpec("devices")
    shared = jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)

    @jax.jit
    def run(*args: Any) -> Any:
        (size,) = {jnp.shape(x)[0] for x in jax.tree.leaves(args)}
        lanes = jnp.minimum(jnp.arange(-(-size // count) * count), size - 1)
        even = args if size % count == 0 else jax.tree.map(lambda x: jnp.asarray(x)[lanes], args)
        return jax.tree.map(lambda x: x[:size], shared(*even))

    return run
