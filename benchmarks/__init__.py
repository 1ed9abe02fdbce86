"""Speed relative to the bare engine; docs/performance.md shows the results."""
