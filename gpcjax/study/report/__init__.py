"""`gpcjax study report`: the rows of a study, its tables and figures. Loads no jax."""
