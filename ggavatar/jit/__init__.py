"""Compiled kernels: compiler, cache, threads, explicit SIMD vectors and small inlined functions."""
