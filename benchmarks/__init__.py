"""Benchmarks and scripts of the developers; docs/results/performance.md shows measured speeds."""
