"""Runs of an optimizer: the main loop, the journal of a run on disk, and the history of a run."""
