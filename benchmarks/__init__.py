"""Benchmarks and scripts for developers; docs/results/performance.md shows measured speeds."""
