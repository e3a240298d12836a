import os

import jax


# float32 is tested beside it: the library follows the dtype of the data.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
if not os.environ.get("STEPAX_TEST_OPTIMISED"):
    # Compiling is most of the time of the tests; `.ci/run` runs the long ones fully optimised.
    jax.config.update("jax_disable_most_optimizations", True)
