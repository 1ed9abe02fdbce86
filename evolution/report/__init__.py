"""Pages and figures of runs and studies."""
