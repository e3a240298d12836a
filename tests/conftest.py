import jax


# float32 is tested beside it: the library follows the dtype of the data.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
