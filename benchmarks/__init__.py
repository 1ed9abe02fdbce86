"""Speed, as ratios against the bare engine in the same run; docs/performance.md shows the results."""
