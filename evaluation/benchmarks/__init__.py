"""Speed of kernels, bags, the running loop and whole workflows."""
