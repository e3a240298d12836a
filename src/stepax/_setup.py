"""How a process of our own, a command or the app, sets JAX up."""

import contextlib
import os
from pathlib import Path


def set_up_jax() -> None:
    """Double precision, few optimisations, and compiled code kept between runs.

    A command works on one record: compiling takes seconds, running milliseconds.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    # Only the time of a cold start depends on these, so no test would notice: optimising costs
    # more than it saves on one record.
    jax.config.update("jax_disable_most_optimizations", True)
    if jax.__version_info__[:2] == (0, 10):  # an XLA that does not know a flag ends the process
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_use_fusion_emitters=false".strip()
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: there is no home
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stepax"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            jax.config.update("jax_compilation_cache_dir", str(folder))
            # JAX keeps only what took a second or more; here hundreds of small functions add up.
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.05)
