"""Compiled kernels: compiler, cache, threads, explicit vectors and the small inlined functions they share."""
