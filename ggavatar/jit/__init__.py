"""Compiled kernels: the compiler and its cache, threads, explicit vectors and the small inlined functions they share."""
