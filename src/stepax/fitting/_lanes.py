"""One loop for one problem or for a batch, in which no lane waits for another.

Under `jax.vmap` a loop runs for all lanes until the slowest has ended. Here a few lanes take a step
together, and one that has ended hands its place to the next in the queue.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._arrays import Count, Flag, Scalar
from .._batches import axes_of, with_batch
from ._solver import BoundedLevenbergMarquardt


SAMPLES_AT_ONCE = 4096
"""Of all lanes that take a step together: what a step computes stays in the cache of a core.

Fewer vectorise worse, more are slower for want of cache: see `benchmarks/methods.py`."""


class Search(NamedTuple):
    """A problem, a start within bounds, and the solver; nothing is done unless it is `wanted`.

    A search that cannot get below the cost to `beat` is given up. `near`: see the solver.
    """

    problem: Any
    start: Array
    lower: Array
    upper: Array
    solver: BoundedLevenbergMarquardt
    wanted: Flag
    near: Any
    beat: Scalar | float = np.inf


class Ended(NamedTuple):
    """Where a search ended, whether it converged there, the number of its steps, cost and J^T J.

    `near`: what the solver knew there.
    """

    x: Array
    converged: Flag
    steps: Count
    cost: Scalar
    matrix: Float[Array, "p p"]
    near: Any


def run_search(search: Search, options: dict[str, Any], max_steps: int) -> Ended:
    """Steps of the solver until it ends; `options` of the solver beside its bounds."""
    arrays, static = eqx.partition(search, eqx.is_array)
    leaves, form = jax.tree.flatten(arrays)

    def whole(leaves: list[Array]) -> Search:
        return eqx.combine(jax.tree.unflatten(form, leaves), static)

    lane = _Lane(whole, options, max_steps, search.problem.record.t.size)

    def together(leaves: list[Array], batched: tuple[bool, ...], size: int) -> Ended:
        if jax.default_backend() == "cpu":
            return _queue(lane, leaves, batched, size)
        return jax.vmap(lane.alone, in_axes=(axes_of(batched),))(leaves)  # as a GPU likes it

    return with_batch(lane.alone, together)(leaves)


@dataclasses.dataclass
class _Lane:
    """What all lanes have in common: how a search is made of arrays, and its loop."""

    whole: Callable[[list[Array]], Search]
    options: dict[str, Any]
    max_steps: int
    rows: int

    def alone(self, leaves: list[Array]) -> Ended:
        """One search."""

        def body(carry):
            y, state, steps = carry
            return *self.step(leaves, y, state), steps + 1

        def goes_on(carry):
            return wanted & ~self.has_ended(*carry[1:])

        wanted = self.whole(leaves).wanted
        carry = jax.lax.while_loop(goes_on, body, (*self.begin(leaves), jnp.array(0)))
        return self.end(leaves, *carry)

    def begin(self, leaves: list[Array]) -> tuple[Array, Any]:
        """Start, and state before the first step."""
        search = self.whole(leaves)
        fn, start, problem, options = self._arguments(search)
        return start, search.solver.init(fn, start, problem, options, None, None, frozenset())

    @functools.cached_property
    def step(self) -> Callable[[list[Array], Array, Any], tuple[Array, Any]]:
        """One step: traced once, however often JAX tries which parts of a loop have lanes."""
        return jax.jit(self._step, inline=True)

    def _step(self, leaves: list[Array], y: Array, state: Any) -> tuple[Array, Any]:
        search = self.whole(leaves)
        fn, _, problem, options = self._arguments(search)
        y, state, _ = search.solver.step(fn, y, problem, options, state, frozenset())
        return y, state

    def has_ended(self, state: Any, steps: Array) -> Array:
        """Whether a search has ended, or each of several."""
        return state.converged | state.failed | (steps >= self.max_steps)

    def end(self, leaves: list[Array], y: Array, state: Any, steps: Count) -> Ended:
        """What comes of a search."""
        search = self.whole(leaves)
        x = jnp.clip(y, search.lower, search.upper)
        converged = state.converged & ~state.failed
        return Ended(x, converged, steps, state.cost, state.matrix, state.near)

    def _arguments(self, search: Search) -> tuple[Any, Array, Any, dict[str, Any]]:
        own = {name: getattr(search, name) for name in ("lower", "upper", "beat", "near")}
        residual = lambda x, problem: (problem.residual(x), None)  # noqa: E731
        return residual, search.start, search.problem, self.options | own


def _queue(lane: _Lane, leaves: list[Array], batched: tuple[bool, ...], size: int) -> Ended:
    """Each place works on a lane; where one has ended, the next in the queue takes its place."""
    axes = axes_of(batched)
    begin = jax.vmap(lane.begin, in_axes=(axes,))
    step = jax.vmap(lane.step, in_axes=(axes, 0, 0))
    end = jax.vmap(lane.end, in_axes=(axes, 0, 0, 0))
    wanted = jax.vmap(lambda x: lane.whole(x).wanted, in_axes=(axes,), axis_size=size)(leaves)
    count, (queue,) = jnp.sum(wanted), jnp.nonzero(wanted, size=size)
    places = max(4, SAMPLES_AT_ONCE // lane.rows)
    places = size if size <= 2 * places else places  # few would leave most places empty in the end

    def of(lanes: Array) -> list[Array]:
        return [x[lanes] if flag else x for x, flag in zip(leaves, batched, strict=True)]

    def body(carry):
        (lanes, busy, y, state, steps), waiting, results = carry
        # the rows are copied once, not in each of the loops that read them
        own = jax.lax.optimization_barrier(of(lanes))
        y, state = step(own, y, state)
        steps = steps + 1
        ended = busy & lane.has_ended(state, steps)
        new = in_rows(end(own, y, state, steps))
        results = results.at[jnp.where(ended, lanes, size)].set(new, mode="drop")
        before = np.tri(places, dtype=bool)  # a sum over few is one loop, `cumsum` five
        turn = waiting + jnp.sum(before & ended[None, :], axis=1) - 1
        enters = ended & (turn < count)
        lanes = jnp.where(enters, queue[jnp.minimum(turn, size - 1)], lanes)
        fresh = (*begin(of(lanes)), jnp.zeros_like(steps))
        y, state, steps = jax.tree.map(
            lambda new, old: jnp.where(enters.reshape(-1, *[1] * (old.ndim - 1)), new, old),
            fresh,
            (y, state, steps),
        )
        at_work = lanes, (busy & ~ended) | enters, y, state, steps
        return at_work, waiting + jnp.sum(ended), results

    lanes, none = queue[:places], jnp.zeros(places, int)
    start, state = jax.vmap(lane.begin, in_axes=(axes,), axis_size=size)(leaves)
    untouched = jax.vmap(lane.end, in_axes=(axes, 0, 0, None), axis_size=size)(
        leaves, start, state, jnp.array(0)
    )
    first = lanes, jnp.arange(places) < count, *begin(of(lanes)), none
    in_rows = jax.vmap(lambda end: ravel_pytree(end)[0])
    unravel = ravel_pytree(jax.tree.map(lambda x: jnp.zeros(x.shape[1:], x.dtype), untouched))[1]
    carry = first, jnp.array(places), in_rows(untouched)
    return jax.vmap(unravel)(jax.lax.while_loop(lambda carry: jnp.any(carry[0][1]), body, carry)[2])
