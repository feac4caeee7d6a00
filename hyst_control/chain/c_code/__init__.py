"""C of the stages, beside the kernels that it equals to the last bit."""
